// The material table: four texels a row. Layout: render/passes/shade.py. PS_HAS_GLOW: some material emits light.

PsSurface ps_material(int row)
{
  vec4 base = texelFetch(ps_materials, ivec2(0, row), 0);
#ifdef PS_HAS_GLOW
  vec3 emission = texelFetch(ps_materials, ivec2(1, row), 0).rgb;
#else
  vec3 emission = vec3(0.0);
#endif
  vec4 rest = texelFetch(ps_materials, ivec2(2, row), 0);
  return PsSurface(base.rgb, emission, rest.y, rest.z, rest.w);
}
