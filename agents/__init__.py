"""Scripts that a user runs from a checkout: train, evaluate, tune, demo."""
