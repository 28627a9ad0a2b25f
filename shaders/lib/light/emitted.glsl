// Records of lights, and how those shine along rays that do not shine evenly to all sides. For lights.glsl.

#define PS_FIRST_LIGHT (PS_TABLE_ROWS + 2)

#ifdef PS_HAS_LIGHTS

vec4 ps_light(int index, int column)
{
  return texelFetch(ps_lights, ivec2(column, PS_FIRST_LIGHT + index), 0);
}

// Rows of lights are sorted by kind; each kind but the last ends where this says.
ivec4 ps_light_ends()
{
  return ivec4(texelFetch(ps_lights, ivec2(4, PS_WORLD_ROW), 0) + 0.5);
}

#ifdef PS_HAS_SPOTS

struct PsCone {
  vec3 direction;
  vec4 axis_u;  // w: cosine of half the angle
  vec4 axis_v;  // w: 1 / range of cosines of the blend
};

PsCone ps_cone_of(int index)
{
  return PsCone(ps_light(index, 2).xyz, ps_light(index, 3), ps_light(index, 4));
}

// blurred: the mean over rays from a patch of the light that is as wide, in units of the distance.
float ps_cone(PsCone cone, vec3 ray, float blurred)
{
  vec3 local = vec3(dot(ray, cone.axis_u.xyz), dot(ray, cone.axis_v.xyz), dot(ray, cone.direction));
  float z = local.z * inversesqrt(max(dot(local, local), 1e-30));
  // The blend fades as far as a step of its spread does, R^2 / 20, that is blurred by a patch, whose spread is 1 / 12 of its square.
  float range = 1.0 / cone.axis_v.w, wide2 = blurred * blurred * max(1.0 - z * z, 0.0);
  float t = clamp((z - cone.axis_u.w - 0.5 * range) * inversesqrt(range * range + 20.0 / 12.0 * wide2) + 0.5, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

#endif

#if defined(PS_HAS_SPOTS) || defined(PS_HAS_BEAMS)
#define PS_UNEVEN_LIGHTS

// How much of its light `index` sends along a ray from one of its points, over what it sends along others.
float ps_emitted(int index, vec3 ray)
{
  ivec4 ends = ps_light_ends();
  float share = 1.0;
#ifdef PS_HAS_SPOTS
  if (index >= ends.y && index < ends.z) {
    share = ps_cone(ps_cone_of(index), ray, 0.0);
  }
#endif
#ifdef PS_HAS_BEAMS
  vec4 direction = ps_light(index, 2);
  if (index >= ends.z && direction.w > 0.0) {
    float along = max(dot(ray, direction.xyz), 1e-30);
    share = max(ps_light(index, 5).x - sqrt(max(dot(ray, ray) - along * along, 0.0)) / along, 0.0);
  }
#endif
  return share;
}

#endif

#endif
