"""Tasks as pure functions: start, reference, observation, reward, end of episode."""
