"""Demonstrations: scripted demonstrators, recording, reading and checking LeRobotDatasets."""
