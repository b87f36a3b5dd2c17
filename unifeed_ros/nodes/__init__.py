"""Thin rclpy shells: convert, call core, publish."""
