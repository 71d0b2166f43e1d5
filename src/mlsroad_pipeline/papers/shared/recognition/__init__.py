"""Recognition of objects: object sets, recognisers and their scores."""
