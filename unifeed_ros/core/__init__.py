"""Everything that teaches, plans and controls; nothing below imports ROS."""
