"""Materials: expression graphs, their evaluation and baking, images and their filtering, the colour of hair."""
