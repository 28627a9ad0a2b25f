// Directions of vectors whose squared lengths are no floats, as those of cofactors of small and large transforms.

// Unit vector along v, and `none` where v has no length.
vec3 ps_direction(vec3 v, vec3 none)
{
  vec3 size = abs(v);
  float largest = max(max(size.x, size.y), size.z);
  return largest > 0.0 ? normalize(v / largest) : none;
}
