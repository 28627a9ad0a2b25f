// Tells captured splats among lit ones, in the channel that holds the kernel's row of others.
#define PS_CAPTURED_KIND 64.0

bool ps_is_captured(float kind)
{
  return abs(kind + 0.5) > PS_CAPTURED_KIND;
}

// And nodes that stand for many of them, among these: the opacity of these is added.
#define PS_NODE_KIND 128.0

bool ps_is_node(float kind)
{
  return abs(kind + 0.5) > PS_NODE_KIND;
}

float ps_node_opacity(float kind)
{
  return abs(kind + 0.5) - PS_NODE_KIND - 0.5;
}
