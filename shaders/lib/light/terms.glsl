// Which terms of light are shaded: all, or with PS_TERM the one that render/passes/shading/terms.py names. Only the
// radiance differs, not what is hidden. PS_TERM_COLOR: in place of radiance the share of even light that is reflected.
// PS_TERM_OCCLUSION: in place of it what surfaces receive of a white world.

#if !defined(PS_TERM) || defined(PS_TERM_EMISSION)
#define PS_SHOWS_EMISSION
#endif
#if !defined(PS_TERM) || defined(PS_TERM_DIFFUSE)
#define PS_SHOWS_DIFFUSE
#endif
#if !defined(PS_TERM) || defined(PS_TERM_GLOSSY)
#define PS_SHOWS_GLOSSY
#endif
#if !defined(PS_TERM) || defined(PS_TERM_VOLUME)
#define PS_SHOWS_VOLUME
#endif
#if !defined(PS_TERM) || defined(PS_TERM_ENVIRONMENT)
#define PS_SHOWS_ENVIRONMENT
#endif
#if defined(PS_SHOWS_DIFFUSE) || defined(PS_SHOWS_GLOSSY)
#define PS_SHOWS_SURFACES
#endif
