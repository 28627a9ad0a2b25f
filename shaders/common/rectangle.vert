// Two triangles over u.rectangle: low and high corner, from 0 to 1 over the target. No vertex attributes.

void main()
{
  int corner = gl_VertexID;
  vec2 at = vec2(corner == 1 || corner == 2 || corner == 4 ? 1.0 : 0.0, corner == 2 || corner > 3 ? 1.0 : 0.0);
  gl_Position = vec4(mix(u.rectangle.xy, u.rectangle.zw, at) * 2.0 - 1.0, 0.0, 1.0);
}
