"""The browser page of a lesson: what it says, what it draws, who may press what; knows nothing of ROS."""
