"""From the sums over samples to what is shown: adaptive sampling, and the picture in the viewport."""
