"""Study of Yu et al. 2016: detection of poles, signs and cars."""
