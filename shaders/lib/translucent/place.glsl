// The depth of what is opaque in a pixel, where it is open, and where nothing is to be blended at all.

#define PS_BEHIND_ALL 1e30
#define PS_NOWHERE -1e30
