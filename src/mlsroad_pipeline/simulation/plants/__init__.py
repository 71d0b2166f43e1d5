"""Plant models: crowns, fronds, hedges."""
