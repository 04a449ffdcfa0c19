"""Many cars in one compiled call: blocks of rows in memory, the kernels over them, the vector environment."""
