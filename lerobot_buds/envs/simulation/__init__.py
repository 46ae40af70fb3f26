"""The robosuite side: the only modules that import robosuite and MuJoCo, themselves imported at first use."""
