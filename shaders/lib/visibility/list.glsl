// Where the entries of the list of all groups lie in its textures.

#define PS_LIST_MASK 4095
#define PS_LIST_SHIFT 12

ivec2 ps_list_texel(int entry)
{
  return ivec2(entry & PS_LIST_MASK, entry >> PS_LIST_SHIFT);
}

#ifdef PS_PLACES
// `entry`: in the order of the pixels.
ivec2 ps_group_texel(int entry)
{
  return ps_list_texel(int(texelFetch(ps_places, ps_list_texel(entry), 0).x));
}
#else
ivec2 ps_group_texel(int entry)
{
  return ps_list_texel(entry);
}
#endif
