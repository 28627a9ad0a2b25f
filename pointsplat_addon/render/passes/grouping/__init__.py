"""Groups of sub-samples that are shaded together: their list, what stands for them, and the pixel filter."""
