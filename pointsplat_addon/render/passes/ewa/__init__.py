"""EWA splatting: elliptical Gaussians, blended and normalised (Zwicker et al. 2001, Ren et al. 2002)."""
