"""What is drawn: one file and one uniform block per pass, in a room for each stage of a picture."""
