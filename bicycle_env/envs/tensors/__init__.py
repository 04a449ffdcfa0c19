"""Many cars on torch tensors."""
