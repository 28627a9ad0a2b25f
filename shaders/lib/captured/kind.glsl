// Tells captured splats among lit ones, in the channel that holds the kernel's row of others.
#define PS_CAPTURED_KIND 64.0

bool ps_is_captured(float kind)
{
  return abs(kind + 0.5) > PS_CAPTURED_KIND;
}
