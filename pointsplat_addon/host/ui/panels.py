"""Panels of the properties editor, and the choice of Blender's own panels that are shown with this engine."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ...render.passes.outputs import PASSES
from ..convert.captured import is_captured
from ..convert.mesh import is_loose_vertices
from . import last_render

ENGINE = "POINTSPLAT"
DRAWN = {"MESH", "CURVE", "SURFACE", "META", "FONT", "POINTCLOUD", "VOLUME", "CURVES"}  # objects that are drawn
WITH_EXTINCTION = {"POINTCLOUD", "VOLUME"}  # objects whose points may be Gaussians of a medium

# Blender's panels for any engine that show what PointSplat does not have.
EXCLUDED = {"RENDER_PT_stereoscopy", "RENDER_PT_output_views", "MATERIAL_PT_freestyle_line"}
EXCLUDED_PREFIXES = ("RENDER_PT_freestyle", "VIEWLAYER_PT_freestyle", "RENDER_PT_gpencil", "RENDER_PT_grease_pencil")
# Panels of EEVEE and Cycles that show what PointSplat does have; their names are alike in all versions.
INCLUDED = {
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "DATA_PT_EEVEE_light",
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_MATERIAL_PT_volume",
    "EEVEE_WORLD_PT_mist",
    "EEVEE_WORLD_PT_surface",
    "MATERIAL_PT_preview",
    "VIEW3D_PT_shading_render_pass",
    "VIEWLAYER_PT_layer_passes",
    "VIEWLAYER_PT_layer_passes_cryptomatte",
}


def can_adapt_samples(scene: bpy.types.Scene) -> bool:
    """Whether the scene's settings allow adaptive sampling to leave out samples; its tooltip gives the reasons."""
    settings = scene.pointsplat
    camera = scene.camera
    through_lens = camera is not None and camera.type == "CAMERA" and camera.data.dof.use_dof
    return settings.technique not in ("VISIBILITY", "PAINTER") and not (
        through_lens and settings.dof_method == "LENS_SAMPLES"
    )


class _Panel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context):
        return context.engine == ENGINE

    def split_layout(self):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout


class POINTSPLAT_RENDER_PT_sampling(_Panel, bpy.types.Panel):
    bl_label = "Sampling"

    def draw(self, context):
        settings, layout = context.scene.pointsplat, self.split_layout()
        column = layout.column(align=True)
        column.prop(context.scene.render, "preview_pixel_size", text="Pixel Size")
        column.prop(settings, "viewport_samples", text="Viewport Samples")
        render = column.row()
        render.active = settings.budget == "NONE"
        render.prop(settings, "samples", text="Render Samples")
        row = layout.column(heading="Adaptive").row(align=True)
        row.active = can_adapt_samples(context.scene)
        row.prop(settings, "use_adaptive_sampling", text="")
        threshold = row.row()
        threshold.active = settings.use_adaptive_sampling
        threshold.prop(settings, "adaptive_threshold", text="")


class POINTSPLAT_RENDER_PT_budget(_Panel, bpy.types.Panel):
    bl_label = "Budget"

    def draw(self, context):
        settings, layout = context.scene.pointsplat, self.split_layout()
        layout.prop(settings, "budget")
        if settings.budget == "TIME":
            layout.prop(settings, "time_budget", text="Milliseconds")
        elif settings.budget == "ERROR":
            layout.prop(settings, "error_budget")


class POINTSPLAT_RENDER_PT_points(_Panel, bpy.types.Panel):
    bl_label = "Points"

    def draw(self, context):
        settings, layout = context.scene.pointsplat, self.split_layout()
        layout.prop(settings, "technique")
        layout.prop(settings, "tolerance")


class POINTSPLAT_RENDER_PT_captured(_Panel, bpy.types.Panel):
    bl_label = "Captured Splats"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and any(is_captured(data) for data in bpy.data.pointclouds)

    def draw(self, context):
        self.split_layout().prop(context.scene.pointsplat, "captured_blending")


class POINTSPLAT_RENDER_PT_shadows(_Panel, bpy.types.Panel):
    bl_label = "Shadows"

    def draw_header(self, context):
        self.layout.prop(context.scene.pointsplat, "use_shadows", text="")

    def draw(self, context):
        settings, layout = context.scene.pointsplat, self.split_layout()
        layout.active = settings.use_shadows
        layout.prop(settings, "shadow_resolution")


class POINTSPLAT_RENDER_PT_indirect(_Panel, bpy.types.Panel):
    bl_label = "Indirect Light"

    def draw_header(self, context):
        self.layout.prop(context.scene.pointsplat, "use_indirect", text="")

    def draw(self, context):
        settings, layout = context.scene.pointsplat, self.split_layout()
        layout.active = settings.use_indirect
        layout.prop(settings, "bounces")


class POINTSPLAT_RENDER_PT_eye_dome(_Panel, bpy.types.Panel):
    bl_label = "Eye-Dome Lighting"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.pointsplat, "use_eye_dome", text="")

    def draw(self, context):
        settings, layout = context.scene.pointsplat, self.split_layout()
        layout.active = settings.use_eye_dome
        layout.prop(settings, "eye_dome_strength")
        layout.prop(settings, "eye_dome_radius")


class POINTSPLAT_RENDER_PT_depth_of_field(_Panel, bpy.types.Panel):
    bl_label = "Depth of Field"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        camera, layout = context.scene.camera, self.split_layout()
        data = camera.data if camera is not None and camera.type == "CAMERA" else None
        if data is not None:
            layout.prop(data.dof, "use_dof", text="Camera")
        row = layout.row()
        row.active = data is not None and data.dof.use_dof
        row.prop(context.scene.pointsplat, "dof_method", text="Method")


class POINTSPLAT_RENDER_PT_motion_blur(_Panel, bpy.types.Panel):
    bl_label = "Motion Blur"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context):
        layout, render = self.split_layout(), context.scene.render
        layout.active = render.use_motion_blur
        layout.prop(render, "motion_blur_position", text="Position")
        layout.prop(render, "motion_blur_shutter")


class POINTSPLAT_RENDER_PT_shutter_curve(_Panel, bpy.types.Panel):
    bl_label = "Shutter Curve"
    bl_parent_id = "POINTSPLAT_RENDER_PT_motion_blur"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, render = self.layout, context.scene.render
        layout.active = render.use_motion_blur
        layout.template_curve_mapping(render, "motion_blur_shutter_curve")


class POINTSPLAT_RENDER_PT_film(_Panel, bpy.types.Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout = self.split_layout()
        layout.prop(context.scene.render, "filter_size")
        layout.prop(context.scene.render, "film_transparent", text="Transparent")


class POINTSPLAT_RENDER_PT_performance(_Panel, bpy.types.Panel):
    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout = self.split_layout()
        layout.prop(context.scene.pointsplat, "device")
        layout.prop(context.scene.pointsplat, "memory_budget")
        layout.prop(context.scene.render, "use_persistent_data", text="Persistent Data")
        layout.operator("pointsplat.clear_cache")


class POINTSPLAT_RENDER_PT_last_render(_Panel, bpy.types.Panel):
    bl_label = "Last Render"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and "technique" in last_render.REPORT

    def draw(self, context):
        layout = self.layout
        for label, value in last_render.lines(last_render.REPORT):
            row = layout.split(factor=0.4)
            row.label(text=label)
            row.label(text=value)
        for name, milliseconds, share in last_render.bars(last_render.REPORT):
            row = layout.split(factor=0.4)
            row.label(text=name.title())
            row.progress(factor=share, text=f"{milliseconds:.1f} ms")


class POINTSPLAT_VIEWLAYER_PT_passes(_Panel, bpy.types.Panel):
    bl_label = "Data"
    bl_context = "view_layer"
    bl_parent_id = "VIEWLAYER_PT_layer_passes"

    def draw(self, context):
        column = self.split_layout().column(heading="Include")
        for p in PASSES:
            # Cryptomatte has a panel of Blender's own.
            if p.switch and "cryptomatte" not in p.switch:
                column.prop(context.view_layer, p.switch)


class POINTSPLAT_VIEWLAYER_PT_light_passes(_Panel, bpy.types.Panel):
    bl_label = "Light"
    bl_context = "view_layer"
    bl_parent_id = "VIEWLAYER_PT_layer_passes"

    def draw(self, context):
        layout, view_layer = self.split_layout(), context.view_layer
        for kind in ("Diffuse", "Glossy", "Transmission"):
            column = layout.column(heading=kind, align=True)
            for part in ("Direct", "Indirect", "Color"):
                column.prop(view_layer, f"use_pass_{kind.lower()}_{part.lower()}", text=part)
        column = layout.column(heading="Volume", align=True)
        column.prop(view_layer.pointsplat, "use_pass_volume_direct", text="Direct")
        column.prop(view_layer.pointsplat, "use_pass_volume_indirect", text="Indirect")
        column = layout.column(heading="Other", align=True)
        column.prop(view_layer, "use_pass_emit", text="Emission")
        column.prop(view_layer, "use_pass_environment")
        column.prop(view_layer, "use_pass_ambient_occlusion")
        world = getattr(view_layer, "world_override", None) or context.scene.world
        if view_layer.use_pass_ambient_occlusion and world is not None:
            column.prop(world.light_settings, "distance")


class POINTSPLAT_DATA_PT_light_shadow(_Panel, bpy.types.Panel):
    bl_label = "Shadow"
    bl_context = "data"
    bl_parent_id = "DATA_PT_EEVEE_light"

    @classmethod
    def poll(cls, context):
        return context.engine == ENGINE and context.light

    def draw(self, context):
        self.split_layout().prop(context.light, "use_shadow", text="Cast Shadow")


class POINTSPLAT_OBJECT_PT_pointsplat(_Panel, bpy.types.Panel):
    bl_label = "PointSplat"
    bl_context = "object"

    @classmethod
    def poll(cls, context):
        return context.engine == ENGINE and context.object and context.object.type in DRAWN

    def draw(self, context):
        ob, layout = context.object, self.split_layout()
        if ob.type == "VOLUME":
            layout.prop(ob.pointsplat, "spacing")
            layout.prop(ob.pointsplat, "extinction")
            self._visibility(ob, layout)
            return
        if ob.type == "CURVES":
            layout.prop(ob.pointsplat, "ribbons")
            self._visibility(ob, layout)
            return
        if ob.type == "POINTCLOUD" and is_captured(ob.data):
            layout.prop(ob.pointsplat, "lighting")
            self._visibility(ob, layout)
            return
        is_points = ob.type == "POINTCLOUD" or (ob.type == "MESH" and is_loose_vertices(ob.data))
        if is_points:  # they are drawn as they are: nothing is sampled
            if ob.type == "POINTCLOUD":
                layout.prop(ob.pointsplat, "shape")
            column = layout.column(align=True)
            column.prop(ob.pointsplat, "radius")
            if ob.type == "POINTCLOUD":
                column.prop(ob.pointsplat, "radius_unit")
        else:
            layout.prop(ob.pointsplat, "primitive")
            row = layout.row()
            row.active = ob.pointsplat.primitive != "POLYGONS"
            row.prop(ob.pointsplat, "spacing")
        if ob.type in WITH_EXTINCTION or len(ob.particle_systems):
            layout.prop(ob.pointsplat, "extinction")
        self._visibility(ob, layout)

    def _visibility(self, ob, layout):
        column = layout.column(heading="Visibility")
        column.prop(ob, "visible_camera", text="Camera")
        if not is_captured(ob.data):  # captured splats light nothing, and hide no sky
            column.prop(ob, "visible_diffuse", text="Diffuse")
            column.prop(ob, "visible_glossy", text="Glossy")
        column.prop(ob, "visible_shadow", text="Shadow")
        if ob.type == "MESH":
            column.prop(ob, "is_shadow_catcher")


class POINTSPLAT_OBJECT_PT_transfer(_Panel, bpy.types.Panel):
    bl_label = "Transfer Function"
    bl_context = "object"
    bl_parent_id = "POINTSPLAT_OBJECT_PT_pointsplat"

    @classmethod
    def poll(cls, context):
        return context.engine == ENGINE and context.object and context.object.type == "VOLUME"

    def draw_header(self, context):
        self.layout.prop(context.object.pointsplat, "use_transfer", text="")

    def draw(self, context):
        ob, layout = context.object, self.split_layout()
        settings = ob.pointsplat
        layout.active = settings.use_transfer
        layout.prop_search(settings, "transfer_grid", ob.data, "grids")
        column = layout.column(align=True)
        column.prop(settings, "transfer_low")
        column.prop(settings, "transfer_high")
        layout.prop(settings, "transfer_density")
        texture = settings.transfer_texture
        if texture is None or texture.color_ramp is None:
            layout.operator("pointsplat.transfer_ramp")
        else:
            layout.template_color_ramp(texture, "color_ramp")


CLASSES = (
    POINTSPLAT_RENDER_PT_sampling,
    POINTSPLAT_RENDER_PT_budget,
    POINTSPLAT_RENDER_PT_points,
    POINTSPLAT_RENDER_PT_captured,
    POINTSPLAT_RENDER_PT_shadows,
    POINTSPLAT_RENDER_PT_eye_dome,
    POINTSPLAT_RENDER_PT_depth_of_field,
    POINTSPLAT_RENDER_PT_motion_blur,
    POINTSPLAT_RENDER_PT_shutter_curve,
    POINTSPLAT_RENDER_PT_film,
    POINTSPLAT_RENDER_PT_performance,
    POINTSPLAT_RENDER_PT_last_render,
    POINTSPLAT_VIEWLAYER_PT_passes,
    POINTSPLAT_VIEWLAYER_PT_light_passes,
    POINTSPLAT_DATA_PT_light_shadow,
    POINTSPLAT_OBJECT_PT_pointsplat,
    POINTSPLAT_OBJECT_PT_transfer,
)


def builtin_panels() -> Iterator[type[bpy.types.Panel]]:
    """Blender's own panels that are shown with this engine."""
    for panel in bpy.types.Panel.__subclasses__():
        name, engines = panel.__name__, getattr(panel, "COMPAT_ENGINES", ())
        if name in INCLUDED or (
            "BLENDER_RENDER" in engines and name not in EXCLUDED and not name.startswith(EXCLUDED_PREFIXES)
        ):
            yield panel


def register() -> None:
    for panel in builtin_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    for panel in bpy.types.Panel.__subclasses__():
        if ENGINE in (engines := getattr(panel, "COMPAT_ENGINES", ())):
            engines.discard(ENGINE)
