"""What runs the laws compiled: numba's namespace and entry points, what is kept of them on disk, random numbers."""
