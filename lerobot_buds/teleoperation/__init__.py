"""A person at the controls: the simulator as a LeRobot robot. Importing this loads neither of the two."""
