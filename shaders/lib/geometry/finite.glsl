// Light that is not a number, infinite or negative must not spread through averages and compositors.
vec3 ps_finite(vec3 c)
{
  return vec3(c.x >= 0.0 && c.x < 1e30 ? c.x : 0.0, c.y >= 0.0 && c.y < 1e30 ? c.y : 0.0,
              c.z >= 0.0 && c.z < 1e30 ? c.z : 0.0);
}
