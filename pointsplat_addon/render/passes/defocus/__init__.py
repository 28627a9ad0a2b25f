"""What is out of focus, gathered once for all samples of a picture."""
