"""The link to the bus: sessions, identities of starts, the router and its refusals."""
