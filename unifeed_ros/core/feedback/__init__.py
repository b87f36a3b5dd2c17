"""What a person taught: demonstrations, corrections, preferences, and the alternatives they are compared with."""
