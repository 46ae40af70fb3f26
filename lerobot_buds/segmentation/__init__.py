"""Skill discovery: hierarchical task structure, temporal segments, skill partition."""
