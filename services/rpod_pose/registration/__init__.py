"""What every registration needs: Lie group, distance field, normal equations, closest points."""
