"""BUDS for LeRobot: skills out of unsegmented demonstrations.

Importing this package registers the policy type ``buds`` and the environment type ``robosuite`` with LeRobot. It
imports configuration modules only; the simulator, torch networks and scikit-learn are loaded where they are used.
"""

from .policy import BudsConfig as BudsConfig
