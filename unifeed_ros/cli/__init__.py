"""The command `unifeed`."""
