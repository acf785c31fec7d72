"""The full shape of a code: occupancy on a grid, coarse first, then marching cubes (NeuSE eq. 4, v_0)."""

from collections.abc import Callable

import numpy as np
import torch
import trimesh
from scipy import ndimage
from skimage.measure import marching_cubes

from neuse.embedding.code import Code
from neuse.embedding.network import UNIT_M, Network
from neuse.errors import InputError
from neuse.geometry import Array, transform_points

COARSE_CELLS = 24  # along each side of the first cube
MAX_CELLS = 160  # along any side of the fine grid
MAX_HALF_M = 0.25  # the first cube grows to this where the shape leaves it
OUTSIDE = -10.0
FAST_BF16 = bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())  # matrix units of the processor

Field = Callable[[Array], np.ndarray]  # logits at points of the object frame


def reconstruct(network: Network, code: Code, resolution_m: float) -> trimesh.Trimesh:
    """Closed mesh of the decoded shape in the code's frame; see Embedding.reconstruct."""

    def field(points: Array) -> np.ndarray:
        return decode(network, code, points)

    low, high = _occupied_box(field, code)
    shape = np.clip(np.ceil((high - low) / resolution_m).astype(int) + 1, 8, MAX_CELLS)
    logits = _fine_logits(field, low, high, shape)
    step = (high - low) / (shape - 1)
    padded = np.pad(logits, 1, constant_values=OUTSIDE)
    padded[padded == 0.0] = -1e-4  # a surface through grid points would leave seams
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="ascent")
    mesh = trimesh.Trimesh((vertices - 1) * step + low, faces, process=False)
    mesh.vertices = transform_points(code.T_frame_object, mesh.vertices)
    return mesh


def decode(network: Network, code: Code, points: Array) -> np.ndarray:
    """Occupancy logits (n,) of a code at (n, 3) points of its object frame, metres; positive inside."""
    device = network.device
    z = torch.from_numpy((code.z - code.center) @ code.T_frame_object[:3, :3] / UNIT_M).float().to(device)
    x = torch.from_numpy(np.ascontiguousarray(points / UNIT_M, dtype=np.float32)).to(device)
    dtype = torch.bfloat16 if FAST_BF16 or device.type != "cpu" else torch.float32
    with torch.inference_mode():
        logits = network.decoder.evaluate(x, z.T, dtype) - network.occupancy_logit
    return logits.cpu().numpy()


def _occupied_box(field: Field, code: Code) -> tuple[Array, Array]:
    """Box of the shape in the object frame, from a coarse cube as large as it takes."""
    half = 1.4 * max(float(np.linalg.norm(code.axes, axis=0).max()), 0.04)
    while True:
        points, step = _grid(np.full(3, -half), np.full(3, half), np.full(3, COARSE_CELLS))
        inside = field(points.reshape(-1, 3)) > 0
        if not inside.any():
            raise InputError(
                "empty_reconstruction", f"a {code.category} code decodes to no shape; it is no such object"
            )
        occupied = points.reshape(-1, 3)[inside]
        if np.abs(occupied).max() < half - step[0] / 2 or half >= MAX_HALF_M:
            break
        half = min(1.5 * half, MAX_HALF_M)
    return occupied.min(axis=0) - 1.2 * step, occupied.max(axis=0) + 1.2 * step


def _fine_logits(field: Field, low: Array, high: Array, shape: np.ndarray) -> np.ndarray:
    """Logits on the fine grid: every second point first, all others only near the surface."""
    coarse_shape = (shape + 1) // 2 + 1
    fine, step = _grid(low, high, shape)
    coarse, _ = _grid(low, low + 2 * step * (coarse_shape - 1), coarse_shape)
    sparse = field(coarse.reshape(-1, 3)).reshape(coarse_shape)
    inside = sparse > 0
    near = ndimage.maximum_filter(inside, 3) != ndimage.minimum_filter(inside, 3)
    near |= np.abs(sparse) < 1.0  # thin walls may pass between the samples
    near_fine = np.kron(near, np.ones((2, 2, 2), dtype=bool))
    upsampled = ndimage.zoom(sparse, 2, order=0, mode="nearest", grid_mode=True)
    window = tuple(slice(0, n) for n in shape)
    logits, wanted = upsampled[window].copy(), near_fine[window]
    logits[wanted] = field(fine[wanted])
    return logits


def _grid(low: Array, high: Array, shape: np.ndarray) -> tuple[Array, Array]:
    """Points (nx, ny, nz, 3) from low to high, and their spacing (3,)."""
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, shape, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1), (high - low) / (np.asarray(shape) - 1)
