// Which splat: see project.vert.
void main()
{
  id = ps_id;
  gl_FragDepth = ps_order;
}
