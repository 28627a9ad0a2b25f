// The material table: four texels a row. Layout: render/passes/shading/shade.py. PS_HAS_GLOW: some material emits light.
// PS_COAT: some surface is coated. PS_BACKLIT: some is lit from behind. PS_TINTED, PS_GLOSS, PS_ROUGH_DIFFUSE, PS_SHEEN, PS_TOON: some
// has what lib/light/brdf.glsl says. PS_ONE_SURFACE: all are alike beyond their colours, which that file reads elsewhere.

PsSurface ps_material(int row)
{
  vec4 base = texelFetch(ps_materials, ivec2(0, row), 0);
#ifdef PS_HAS_GLOW
  vec3 emission = texelFetch(ps_materials, ivec2(1, row), 0).rgb;
#else
  vec3 emission = vec3(0.0);
#endif
#ifdef PS_COAT
  ps_coat = PsCoat(texelFetch(ps_materials, ivec2(4, row), 0).xyz, texelFetch(ps_materials, ivec2(5, row), 0).rgb);
#endif
#if defined(PS_TINTED) || defined(PS_ROUGH_DIFFUSE)
  vec4 tint = texelFetch(ps_materials, ivec2(7, row), 0);
#endif
#ifdef PS_TINTED
  ps_tint = tint.rgb;
#endif
#ifdef PS_GLOSS
  ps_gloss = texelFetch(ps_materials, ivec2(10, row), 0);
#endif
#ifdef PS_ROUGH_DIFFUSE
  ps_diffuse_roughness = tint.a;
#endif
#ifdef PS_SHEEN
  ps_sheen = texelFetch(ps_materials, ivec2(8, row), 0);
#endif
#ifdef PS_TOON
  ps_toon = texelFetch(ps_materials, ivec2(9, row), 0).xyz;
#endif
#ifdef PS_BACKLIT
  ps_backlit = texelFetch(ps_materials, ivec2(6, row), 0).rgb;
#endif
#if defined(PS_ONE_SURFACE) && !defined(PS_STRANDS)
  vec4 rest = vec4(0.0);
#else
  vec4 rest = texelFetch(ps_materials, ivec2(2, row), 0);
#endif
#ifdef PS_SPREAD
  return PsSurface(base.rgb, emission, rest.y, rest.z, rest.w, 0.0);
#else
  return PsSurface(base.rgb, emission, rest.y, rest.z, rest.w);
#endif
}
