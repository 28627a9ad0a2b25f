"""Names and tooltips of the settings and of their choices."""

from ...core.scene.settings import BLENDINGS, BUDGETS, DEVICES, DOF_METHODS, TECHNIQUES

Item = tuple[str, str, str]

TECHNIQUE_ITEMS: dict[str, Item] = {
    "AUTO": (
        "AUTO",
        "Automatic",
        "The default: the Visibility Buffer wherever it can draw the scene. With a budget, Lens Samples or more "
        "triangles than it can draw, EWA for points that have colours of their own and Image Space for the rest",
    ),
    "VISIBILITY": (
        "VISIBILITY",
        "Visibility Buffer",
        "Exact edges, and each surface in a pixel is shaded once: what Automatic takes for nearly all scenes. "
        "Sparse balls cover what they should; meshes are polygons unless their objects are set to Points",
    ),
    "IMAGE_SPACE": (
        "IMAGE_SPACE",
        "Image Space",
        "Project each point to one pixel and fill the gaps between them in the picture, for surfaces of so many "
        "points that levels of detail stand for them. Sparse balls run together: they cover too much",
    ),
    "EWA": (
        "EWA",
        "EWA",
        "Blend points as Gaussians no finer than the pixels, so that textures of surfaces do not flicker from afar; "
        "edges are soft. Sparse balls are too faint: they cover too little",
    ),
    "PAINTER": (
        "PAINTER",
        "Painter",
        "Paint points as fuzzy ellipses from back to front, so that they mix with smoke and glass point by point. "
        "Sparse balls cover what they should, but are too bright and mix with those behind them",
    ),
}
BUDGET_ITEMS: dict[str, Item] = {
    "NONE": ("NONE", "None", "Samples and tolerance are what the settings say"),
    "TIME": (
        "TIME",
        "Time",
        "As many samples and as fine a cut, up to the tolerance, as the time allows, judged by earlier pictures",
    ),
    "ERROR": ("ERROR", "Error", "Samples, and a finer tolerance where they do not suffice, until the error is small"),
}
DEVICE_ITEMS: dict[str, Item] = {
    "AUTO": ("AUTO", "Automatic", "An OpenGL context of its own for final renders, Blender's in the viewport"),
    "BLENDER_GPU": (
        "BLENDER_GPU",
        "Blender GPU",
        "Draw with Blender's graphics backend; final renders block the window",
    ),
    "OPENGL": (
        "OPENGL",
        "OpenGL",
        "Draw final renders on an OpenGL context of its own, so that the window stays alive",
    ),
}
DOF_ITEMS: dict[str, Item] = {
    "SPLAT": (
        "SPLAT",
        "Splat",
        "Enlarge each splat by its circle of confusion: what is more out of focus takes fewer splats. "
        "The aperture is treated as a disk",
    ),
    "LENS_SAMPLES": (
        "LENS_SAMPLES",
        "Lens Samples",
        "Draw each sample through another point of the aperture: exact with many samples, blades and ratio included",
    ),
}
PRIMITIVE_ITEMS: dict[str, Item] = {
    "AUTO": (
        "AUTO",
        "Automatic",
        "Polygons. The other techniques than the Visibility Buffer draw points where triangles are small in the "
        "picture",
    ),
    "POINTS": ("POINTS", "Points", "Sample the surface with points"),
    "POLYGONS": (
        "POLYGONS",
        "Polygons",
        "Draw the triangles themselves, but points where materials are translucent; curves with a bevel become meshes",
    ),
    "LINES": ("LINES", "Lines", "Draw curves with a round bevel as tubes along their points; the rest as by Automatic"),
}
SHAPE_ITEMS: dict[str, Item] = {
    "BALLS": ("BALLS", "Balls", "Balls, as other engines draw points"),
    "DISKS": (
        "DISKS",
        "Disks",
        "Disks across the attribute normal, else across the plane of each point's neighbours, with the points' radius",
    ),
    "SURFACE": (
        "SURFACE",
        "Surface",
        "Disks that close the surface of a scan between its points, however dense they are. "
        "Points whose neighbours lie on no plane, as those of leaves and wires, stay balls",
    ),
}
RADIUS_UNIT_ITEMS: dict[str, Item] = {
    "OBJECT": ("OBJECT", "Object", "The object's unit of length, before its scale"),
    "SPACING": ("SPACING", "Spacing", "The median distance between points and their nearest neighbours"),
    "PIXELS": (
        "PIXELS",
        "Pixels",
        "Pixels of the picture, or of the viewport, whatever the distance: each view sizes all points anew, which "
        "takes time for very many in a viewport that moves. Shadows are as wide as what the view shows",
    ),
}

BLENDING_ITEMS: dict[str, Item] = {
    "LINEAR": ("LINEAR", "Linear", "Colours are turned to linear light splat by splat, and blended as all else is"),
    "TRAINED": (
        "TRAINED",
        "As Trained",
        "Display values (sRGB) are blended, over those of the world, and turned to linear light pixel by pixel: with "
        "the view transform Standard the picture is the one that training saw. Where captured splats are alone in "
        "view, without depth of field and unlit; else Linear, with a warning",
    ),
}
LIGHTING_ITEMS: dict[str, Item] = {
    "CAPTURED": ("CAPTURED", "As Captured", "The light of the capture, whatever lamps there are"),
    "SHADOWED": (
        "SHADOWED",
        "Shadow Receiver",
        "The light of the capture, darker where other objects keep the light of lamps away. The world's light, which "
        "casts no shadows, and all lamps are weighed as on a white surface",
    ),
    "RELIT": (
        "RELIT",
        "Relit",
        "Captured colours are those of a dull surface, lit by lamps and the world, with shadows of everything. Its "
        "normals are estimated: flat splats lie in their surface, round ones ask their neighbours",
    ),
}

CLIP_ITEMS: list[Item] = [
    ("INSIDE", "Inside", "Points in any of the boxes"),
    ("OUTSIDE", "Outside", "Points in none of the boxes"),
]

# Name and tooltip of each field of Settings
LABELS: dict[str, tuple[str, str]] = {
    "technique": ("Technique", "How points become pixels"),
    "tolerance": (
        "Tolerance",
        "Size in pixels below which one point is drawn instead of the finer ones that it covers; smaller is more exact",
    ),
    "samples": (
        "Render",
        "Number of sub-pixel samples that are averaged for each pixel of a final render. The Visibility Buffer rounds "
        "it up to 1, 5 or a multiple of 17",
    ),
    "viewport_samples": (
        "Viewport",
        "Number of sub-pixel samples that are averaged in the viewport while it is still. The Visibility Buffer rounds "
        "it up to a multiple of 5",
    ),
    "use_adaptive_sampling": (
        "Adaptive Sampling",
        "Parts of the picture whose samples agree get no more of them. The Visibility Buffer draws all samples of a "
        "pixel at once; pictures with translucent objects or strands thinner than a pixel, the technique Painter and "
        "depth of field by Lens Samples need all samples everywhere",
    ),
    "adaptive_threshold": (
        "Threshold",
        "Difference between the means of all samples and of half of them below which no more are taken; "
        "smaller is more exact",
    ),
    "captured_blending": ("Blending", "How the colours of captured Gaussian splats are blended"),
    "use_shadows": ("Shadows", "Lights cast shadows, which translucent objects soften and tint"),
    "shadow_resolution": (
        "Resolution",
        "Number of cells in half a turn around each light in which shadows are stored; more make sharper shadows. "
        "Depth maps of lights without a size have twice as many texels along a side",
    ),
    "use_indirect": (
        "Indirect Light",
        "Objects, smoke and clouds hide the world from each other and send each other light; sharp mirrors show the "
        "meshes around them. Drawn by the Visibility Buffer; viewports have it once the view has stood still",
    ),
    "bounces": (
        "Bounces",
        "Number of times that light goes from surface to surface, or is scattered again in smoke, before it reaches "
        "what is seen; without any, objects hide the world, and those that emit light shine",
    ),
    "use_eye_dome": (
        "Eye-Dome Lighting",
        "Pixels are darker the more their neighbours lie in front of them, so that scans without light or colour show "
        "their shape (Boucheny 2009). Drawn by the Visibility Buffer, without depth of field",
    ),
    "eye_dome_strength": ("Strength", "How much a step in depth darkens what lies behind it"),
    "eye_dome_radius": ("Radius", "Distance of the neighbours that a pixel is compared with, in pixels of the picture"),
    "dof_method": ("Depth of Field", "How cameras with depth of field blur what is out of focus"),
    "budget": ("Budget", "What decides how many samples are drawn and how coarse the points may be"),
    "time_budget": (
        "Time",
        "Milliseconds that a final render may take once the scene is converted, and a picture of the viewport while "
        "it moves",
    ),
    "error_budget": (
        "Error",
        "Root mean square error that a picture may have against very many samples at a quarter of the tolerance, "
        "in scene-linear values",
    ),
    "memory_budget": (
        "Memory Budget",
        "Megabytes that scans which are read by pages take in memory, what is drawn of them included; where a picture"
        " needs more, it is drawn more coarsely",
    ),
    "device": ("Device", "What draws the pictures"),
}
ITEMS = {
    "captured_blending": [BLENDING_ITEMS[n] for n in BLENDINGS],
    "technique": [TECHNIQUE_ITEMS[n] for n in TECHNIQUES],
    "dof_method": [DOF_ITEMS[n] for n in DOF_METHODS],
    "budget": [BUDGET_ITEMS[n] for n in BUDGETS],
    "device": [DEVICE_ITEMS[n] for n in DEVICES],
}
