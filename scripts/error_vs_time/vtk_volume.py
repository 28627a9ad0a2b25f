"""VTK draws voxels that absorb, before white: what scripts/error_vs_time/measure.py compares with."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

NODES = 256  # of the opacity's table: within one, VTK is linear
PARTS = 2.0  # samples for each voxel along a ray


class VolumeView:
    """A window of a volume (X, Y, Z) of densities at integer indices, `extinction` per world unit where it is 1.

    world_from_index, view_from_world: (4, 4) float64; `focal`: distance of the picture over half its height. `size`:
    pixels along the sides of the square window. ImportError where VTK is missing.
    """

    def __init__(
        self,
        values: np.ndarray,
        world_from_index: np.ndarray,
        extinction: float,
        view_from_world: np.ndarray,
        focal: float,
        size: int,
    ) -> None:
        import vtk
        from vtk.util.numpy_support import numpy_to_vtk

        # VTK's longest axis in memory is z.
        image = vtk.vtkImageData()
        image.SetDimensions(*values.shape)
        data = np.ascontiguousarray(values.transpose(2, 1, 0), np.float32).reshape(-1)
        image.GetPointData().SetScalars(numpy_to_vtk(data, deep=1))
        # Lengths are the world's: VTK's mappers measure along rays before the actor's matrix.
        scale = float(np.abs(np.linalg.det(world_from_index[:3, :3])) ** (1 / 3))
        image.SetSpacing(scale, scale, scale)
        place = np.array(world_from_index, float)
        place[:3, :3] /= scale

        opacity, color, look = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction(), vtk.vtkVolumeProperty()
        for density in np.linspace(0, float(values.max()), NODES).tolist():
            opacity.AddPoint(density, 1 - np.exp(-extinction * density * scale))
        color.AddRGBPoint(0, 0, 0, 0)
        look.SetScalarOpacity(opacity)
        look.SetScalarOpacityUnitDistance(scale)
        look.SetColor(color)
        look.SetInterpolationTypeToLinear()
        look.ShadeOff()

        mapper = vtk.vtkFixedPointVolumeRayCastMapper()  # the processor's: without a GPU the faster one
        mapper.SetInputData(image)
        mapper.AutoAdjustSampleDistancesOff()
        mapper.SetImageSampleDistance(1)
        mapper.SetSampleDistance(scale / PARTS)
        mapper.SetInteractiveSampleDistance(scale / PARTS)
        volume = vtk.vtkVolume()
        volume.SetMapper(mapper)
        volume.SetProperty(look)
        matrix = vtk.vtkMatrix4x4()
        matrix.DeepCopy(place.reshape(-1).tolist())
        volume.SetUserMatrix(matrix)

        renderer = vtk.vtkRenderer()
        renderer.SetBackground(1, 1, 1)
        renderer.AddVolume(volume)
        self._window: Any = getattr(vtk, "vtkEGLRenderWindow", vtk.vtkRenderWindow)()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._window.SetSize(size, size)
        self._window.AddRenderer(renderer)
        world = np.linalg.inv(view_from_world)
        view = renderer.GetActiveCamera()
        view.SetPosition(*world[:3, 3])
        view.SetFocalPoint(*(world[:3, 3] - world[:3, 2]))
        view.SetViewUp(*world[:3, 1])
        view.SetViewAngle(2 * float(np.degrees(np.arctan(1 / focal))))
        renderer.ResetCameraClippingRange()

    def frame(self) -> tuple[np.ndarray, float]:
        """The picture (H, W, 3) float64 in [0, 1], bottom row first, and the processor's seconds."""
        import vtk
        from vtk.util.numpy_support import vtk_to_numpy

        start = time.process_time()
        self._window.Render()
        self._window.WaitForCompletion()
        seconds = time.process_time() - start
        grab = vtk.vtkWindowToImageFilter()
        grab.SetInput(self._window)
        grab.ReadFrontBufferOff()
        grab.Update()
        output = grab.GetOutput()
        width, height, _ = output.GetDimensions()
        pixels = vtk_to_numpy(output.GetPointData().GetScalars()).reshape(height, width, -1)
        return pixels[..., :3] / 255.0, seconds

    def close(self) -> None:
        self._window.Finalize()
