// A surfel into the textures of a G-buffer. PS_FRONT: and the depth of its near end, which is what may hide behind others.

#include "lib/geometry/surfel.glsl"

#define PS_BRIGHTEST 65504.0  // what a texture of half floats holds; an infinity would be drawn black

void ps_store(PsSurfel s)
{
  out_centre = s.centre;
  out_shape = s.shape;
#ifdef PS_NORMAL
  out_normal = s.normal;
#endif
#ifdef PS_COLOR
  out_color = clamp(s.color, -PS_BRIGHTEST, PS_BRIGHTEST);
#endif
#ifdef PS_EMISSION
  out_emission = clamp(s.emission, -PS_BRIGHTEST, PS_BRIGHTEST);
#endif
#ifdef PS_TANGENT
  out_tangent = s.tangent;
#endif
#if defined(PS_VELOCITY)
  out_owner = vec4(int(s.owner), s.velocity);
#elif defined(PS_OWNER)
  out_owner = s.owner;
#endif
}

// Beyond the near plane, so that 0, to which textures are cleared, means that nothing covers the pixel.
void ps_store_front(PsSurfel s, bool covers)
{
  ps_store(s);
#ifdef PS_FRONT
  float front = (s.centre.w > 0.0 ? s.centre.x - s.centre.w : s.centre.x) - u.near;
  out_front = covers ? max(front, 1e-30) : 0.0;
#endif
}
