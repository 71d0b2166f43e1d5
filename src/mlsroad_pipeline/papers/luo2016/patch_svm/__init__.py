"""Support vector machine on patches, a baseline of Luo et al. 2016."""
