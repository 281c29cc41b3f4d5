"""What ring images say of the head itself: cones, poses and residuals from a clean pipe or a flat target."""
