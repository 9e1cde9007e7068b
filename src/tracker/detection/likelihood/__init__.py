"""Maximum-likelihood fits of glints: the pixel model, its Cramer-Rao bound, and the priors of the fits."""
