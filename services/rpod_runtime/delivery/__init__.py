"""Messages on their way: a publisher, the receiving side, and the counts of what came."""
