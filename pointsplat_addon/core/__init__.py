"""Arrays in, arrays out: clouds, hierarchies, cuts and the float64 reference. numpy only."""
