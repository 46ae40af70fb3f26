"""The policy type `buds`: a library of goal-conditioned skills and a meta controller."""
