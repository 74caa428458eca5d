"""Tools shared by all registrations: Lie group, distance field, normal equations, closest points."""
