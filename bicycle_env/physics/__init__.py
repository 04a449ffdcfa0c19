"""The car: parameters, tires, equations of motion, actuators, integration. Imports numpy and numba only."""
