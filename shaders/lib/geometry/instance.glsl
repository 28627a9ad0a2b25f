// Instances, and pages of 4,096-wide textures. PS_ONE_INSTANCE: its matrix is a uniform; else `ps_instances` has three
// rows for each, and a fourth: holdout, scale of lengths (only of strands); of polygons see render/passes/visibility/polygon_draw.py.
// Layout: render/passes/image_space/projection.py.

#include "lib/geometry/camera.glsl"
#include "lib/geometry/direction.glsl"

#define PS_PAGE_SHIFT 12
#define PS_PAGE_MASK 4095

ivec2 ps_texel(int index)
{
  return ivec2(index & PS_PAGE_MASK, index >> PS_PAGE_SHIFT);
}

#ifdef PS_ONE_INSTANCE

vec3 ps_view_from_point(int instance, vec3 p)
{
  return (u.view_from_object * vec4(p, 1.0)).xyz;
}

mat3 ps_linear(int instance)
{
  return mat3(u.view_from_object);
}

#else

vec4 ps_instance_row(int instance, int row)
{
  return texelFetch(ps_instances, ps_texel(instance * 4 + row), 0);
}

vec3 ps_view_from_point(int instance, vec3 p)
{
  vec4 x = ps_instance_row(instance, 0), y = ps_instance_row(instance, 1), z = ps_instance_row(instance, 2);
  // In the order of a product with a matrix: one instance alone then lies where it lies among others, to the last bit.
  return vec3(x.x, y.x, z.x) * p.x + vec3(x.y, y.y, z.y) * p.y + vec3(x.z, y.z, z.z) * p.z + vec3(x.w, y.w, z.w);
}

mat3 ps_linear(int instance)
{
  return transpose(mat3(ps_instance_row(instance, 0).xyz, ps_instance_row(instance, 1).xyz,
                        ps_instance_row(instance, 2).xyz));
}

#endif

// Normals transform by the cofactor matrix, which needs no inverse and keeps its sense under mirrors.
vec3 ps_view_normal(mat3 linear, vec3 n)
{
  vec3 v = cross(linear[1], linear[2]) * n.x + cross(linear[2], linear[0]) * n.y + cross(linear[0], linear[1]) * n.z;
  return ps_direction(v, vec3(0.0, 0.0, 1.0));
}
