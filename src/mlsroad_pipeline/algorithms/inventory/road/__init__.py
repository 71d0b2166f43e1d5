"""The road itself: width, crossfall, slope, ruts, evenness and clearance along the path of a survey."""
