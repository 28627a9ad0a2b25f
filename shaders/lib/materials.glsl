// The material table: four texels a row. Layout: render/passes/shade.py.

PsSurface ps_material(int row)
{
  vec4 base = texelFetch(ps_materials, ivec2(0, row), 0);
  vec4 emission = texelFetch(ps_materials, ivec2(1, row), 0);
  vec4 rest = texelFetch(ps_materials, ivec2(2, row), 0);
  return PsSurface(base.rgb, emission.rgb, rest.y, rest.z, rest.w, emission.w);
}
