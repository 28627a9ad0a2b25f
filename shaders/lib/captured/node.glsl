// What a node hides, which stands for many captured splats at one place: each hides its share of what the others leave.
// Each also ends where it is too faint, where exactly depends on its opacity and on its place in the node: of many, so
// many are left where the mean one is `one`.

#define PS_FAINTEST_NODE 0.25  // of PS_LEAST_ALPHA: opacity of the mean splat where almost none is left

float ps_faintest(float kind)
{
  return ps_node_opacity(kind) / (PS_FAINTEST_NODE * PS_LEAST_ALPHA);
}

// alpha: the sum of the opacities of all at a pixel; total: the same at the middle.
float ps_node_alpha(float alpha, float total, float kind)
{
  float each = ps_node_opacity(kind), one = alpha * each / total;
  float x = one / PS_LEAST_ALPHA, left = x * x * x / (1.0 + x * x * x);
  float hidden = 1.0 - pow(1.0 - min(one, PS_MOST_ALPHA), left * total / each);
  return one > PS_FAINTEST_NODE * PS_LEAST_ALPHA ? hidden : 0.0;
}
