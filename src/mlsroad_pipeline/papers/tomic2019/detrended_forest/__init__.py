"""Random forest on detrended supervoxel features (Tomic et al. 2019, section 2.1)."""
