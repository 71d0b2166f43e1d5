"""Random forest on multiscale spherical neighbourhoods (Thomas et al. 2018)."""
