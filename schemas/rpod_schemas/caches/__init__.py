"""What a host keeps from one start to the next: compiled kernels, and the folder of built targets."""
