// Fog that fills all of the world, the same everywhere (core/light/fog.py): Beer's law. For lights.glsl. PS_FOG: there is some.
// Texels of the world's row of ps_lights from this one on: extinction, and how far before the eye the fog begins; scattering,
// and Henyey and Greenstein's g; radiance that is emitted per unit of length.

#ifdef PS_FOG

#define PS_FOG_TEXEL 5

vec4 ps_fog_texel(int i)
{
  return texelFetch(ps_lights, ivec2(PS_FOG_TEXEL + i, PS_WORLD_ROW), 0);
}

// Share of light that is left after a way through the fog.
vec3 ps_fog_left(float distance)
{
  return exp(-ps_fog_texel(0).rgb * distance);
}

#endif
