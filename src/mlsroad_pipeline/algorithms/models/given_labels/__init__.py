"""Labels that a survey comes with, or that another network gave: a method without training."""
