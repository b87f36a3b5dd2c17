"""The arm in MuJoCo, tasks with true rewards, and simulated people; built on core only."""
