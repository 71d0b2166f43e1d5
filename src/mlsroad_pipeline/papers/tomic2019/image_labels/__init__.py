"""Labels of points from images: cameras, projection, visibility, segmentation."""
