// Bits of depths, of numbers of which negative ones stand for nothing: render/passes/shadow/kept_depths.py.

void main()
{
  float depth = texelFetch(ps_kept, ivec2(gl_FragCoord.xy), 0).x;
  out_depth = depth < 0.0 ? 0xFFFFFFFFu : floatBitsToUint(depth);
}
