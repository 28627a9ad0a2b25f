"""Mathematics on arrays that knows nothing of scenes: vectors, segments, sample sequences, small matrices."""
