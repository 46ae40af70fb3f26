"""The robosuite tasks as LeRobot environments."""
