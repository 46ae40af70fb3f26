"""A person at the controls of the simulator, by LeRobot's own commands. LeRobot finds each device by its type."""
