"""What a service does as a process: its life, its reserve, its manager, and other processes."""
