"""From a reward to a motion: eq. M10 as sequential quadratic programming in joint space."""
