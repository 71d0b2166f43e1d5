"""Road markings from intensity: brightness against the road, bright stripes, and lines through them."""
