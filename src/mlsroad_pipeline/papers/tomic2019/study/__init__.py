"""Study of Tomic et al. 2019: detrended forest, PSPNet and their fusion."""
