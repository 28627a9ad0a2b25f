// Of which depths on the layer behind one of panes may be, the bits inverted; 0: nothing is behind it.

#define PS_NOWHERE 0xFFFFFFFFu
#define PS_ROUNDING 8u  // units in the last place: a pane does not lie behind itself

void main()
{
  uint depth = texelFetch(ps_depths, ivec2(gl_FragCoord.xy), 0).x;
  out_depth = depth == PS_NOWHERE ? 0u : ~(depth + PS_ROUNDING);
}
