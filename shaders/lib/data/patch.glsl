// Area of a triangle in UV, from how UV changes along two of its edges.
float ps_patch_area(vec2 along_a, vec2 along_b)
{
  return 0.5 * abs(along_a.x * along_b.y - along_a.y * along_b.x);
}
