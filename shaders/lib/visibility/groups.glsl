// The groups of a pixel's sub-samples that are shaded together: three bits for each sub-sample in two words, the first ten
// in the first. The second word ends with the number of groups and the flags below.

#define PS_GROUPS 4  // of a pixel, at most
#define PS_NO_GROUP 7u  // nothing covers the sub-sample
#define PS_COUNT_SHIFT 21u
#define PS_UNIFORM 0x1000000u  // all sub-samples have one code
#define PS_OPEN 0x2000000u  // some sub-sample is not covered

uint ps_group(uvec2 codes, int sub_sample)
{
  return 7u & (sub_sample < 10 ? codes.x >> uint(3 * sub_sample) : codes.y >> uint(3 * (sub_sample - 10)));
}

uvec2 ps_with_group(uvec2 codes, int sub_sample, uint group)
{
  return sub_sample < 10 ? uvec2(codes.x | (group << uint(3 * sub_sample)), codes.y)
                         : uvec2(codes.x, codes.y | (group << uint(3 * (sub_sample - 10))));
}

int ps_group_count(uvec2 codes)
{
  return int((codes.y >> PS_COUNT_SHIFT) & 7u);
}

// Where groups lie in the list of all, of which a row has PS_LIST_MASK + 1. PS_PLACES: they are not listed in the order of
// their pixels.
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
