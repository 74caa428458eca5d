"""The process of a service: its life, its reserve, its manager, and other processes."""
