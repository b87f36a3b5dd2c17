"""What others do for the same task, to measure against."""
