"""One car: the Gymnasium environment, and the entry point of its step."""
