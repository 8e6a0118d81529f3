"""Boundary element method for sound outside a closed surface.

Flat triangles, with the combination of Burton and Miller (Proceedings of the Royal Society A 323, 1971),
which has no spurious resonances and holds for thin walls. The pressure is continuous and linear on each
triangle: its unknowns are those of the vertices, half as many as triangles. Kernels are those of constant
elements collocated at the centroids, where the linear functions have their means, and the equations are
weighted by the same functions. Fields are phasors of exp(-i w t); waves of wavenumber k go out as
exp(i k r) / r.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from objectfolder.sound.radiation.triangles import Triangles, static_integrals

NEAR_DISTANCE = 2.2  #: edge lengths within which static kernels are integrated exactly
_ROWS = 32  # of the matrix that are made at once: their intermediates stay in the cache
_EDGE_POINTS = 8  # Gauss points on each edge, for a triangle's effect on itself


@dataclass(frozen=True)
class _Near:
    """Pairs of collocation points and near triangles, in order of the points."""

    rows: np.ndarray  # (P,)
    columns: np.ndarray  # (P,)
    starts: np.ndarray  # (N + 1,) first pair of each row
    static: np.ndarray  # (4, P) integrals for k = 0: single, double, adjoint, hypersingular
    distance: np.ndarray  # (Q, P) float32, of the quadrature points
    towards: np.ndarray  # (Q, P) float32, cosine to the point's normal
    outward: np.ndarray  # (Q, P) float32, cosine to the triangle's normal
    aligned: np.ndarray  # (P,) float32, cosine between the normals
    weight: np.ndarray  # (P,) float32, area of the triangle over Q

    @property
    def both(self) -> np.ndarray:
        """(Q, P) product of the cosines."""
        return self.towards * self.outward


class Boundary:
    """Closed surface of triangles, outward: vertices (V, 3), metres, and faces (N, 3).

    ``mean_edge`` is the edge of an equilateral triangle of mean area, metres.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self.triangles = Triangles.of(vertices, faces)
        self.mean_edge = float(np.sqrt(self.triangles.area.mean() * 4 / np.sqrt(3)))
        places = self.triangles.centroid.astype(np.float32)
        normals = self.triangles.normal.astype(np.float32)
        self._single = places, normals, (places**2).sum(1), (places * normals).sum(1)
        self._near = self._near_pairs()
        self._own = _own_edges(self.triangles)
        self._mean = _vertex_means(faces)
        self._weights = csr_array(self._mean.T) * (self.triangles.area / self.triangles.area.mean())
        self._weights = csr_array(self._weights, dtype=np.float32)
        self._closure = self._closed()

    def __len__(self) -> int:
        return len(self.triangles.area)

    def pressure(self, wavenumber: float, slopes: np.ndarray) -> np.ndarray:
        """Solve for the pressure at a wavenumber, 1/m: means over the triangles, Pa, (N, M) complex64.

        Slopes (N, M) are the outward derivative of the pressure, Pa/m, of each triangle: minus the density of
        air times the outward acceleration.
        """
        return self.solve(*self.system(wavenumber, slopes))

    def solve(self, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solve a `system`, which is overwritten, for the means of the pressure over the triangles (N, M)."""
        factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
        return self._mean @ lu_solve(factors, right, check_finite=False)

    def system(self, wavenumber: float, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return matrix (V, V) and right-hand sides (V, M) for the pressures of the vertices, complex64.

        With single layer S, double layer D, its adjoint D' and hypersingular H, and the coupling i / k,

            (1/2 - D - i/k H) p = -(S + i/k (1/2 + D')) dp/dn
        """
        k, mesh, near = wavenumber, self.triangles, self._near
        count = len(self)
        coupling = self.mean_edge / np.hypot(1, k * self.mean_edge)  # smooth in k
        beta, k32 = np.float32(coupling), np.float32(k)
        spread = csr_array(self._mean.T)
        matrix = np.empty((count, spread.shape[0]), np.complex64)
        slopes = np.asarray(slopes, np.complex64)
        right = np.empty((count, slopes.shape[1]), np.complex64)
        singles, doubles, adjoints, hypers = self._near_integrals(k)
        own_single, own_hyper = self._own_integrals(k)
        near_left = -doubles - np.complex64(1j * coupling) * hypers
        near_right = singles + np.complex64(1j * coupling) * adjoints
        share = (mesh.area / (4 * np.pi)).astype(np.float32)
        for start in range(0, count, _ROWS):
            rows = slice(start, min(start + _ROWS, count))
            inner = np.arange(rows.stop - rows.start)
            inverse, towards, outward, bend = self._seen(rows)
            phase = k32 / inverse
            size = share * inverse
            real, imaginary = np.cos(phase) * size, np.sin(phase) * size
            both = towards * outward
            across = inverse * (outward + beta * k32 * bend)
            along = beta * (inverse**2 * bend - k32**2 * both) - k32 * outward
            block = np.empty(real.shape, np.complex64)
            block.real = real * across - imaginary * along
            block.imag = real * along + imaginary * across
            pairs = slice(near.starts[rows.start], near.starts[rows.stop])
            place = near.rows[pairs] - start, near.columns[pairs]
            block[place] = near_left[pairs]
            block[inner, inner + start] = 0.5 - 1j * coupling * (own_hyper[rows] + self._closure[1, rows])
            matrix[rows] = (spread @ np.ascontiguousarray(block.T)).T
            across, along = 1 + beta * k32 * towards, beta * inverse * towards
            block.real = real * across - imaginary * along
            block.imag = real * along + imaginary * across
            block[place] = near_right[pairs]
            block[inner, inner + start] = own_single[rows] + 1j * coupling * (0.5 + self._closure[0, rows])
            right[rows] = -block @ slopes
        return self._weights @ matrix, self._weights @ right

    def _seen(self, rows: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Geometry of some collocation points and all centroids, (R, N) float32 each.

        One over the distance, cosines to the normals of point and triangle, and 3 times their product less
        the cosine between the normals. An element's own distance counts as 1 m.
        """
        places, normals, squares, heights = self._single
        square = squares[rows, None] + squares - 2 * (places[rows] @ places.T)
        inner = np.arange(len(square))
        square[inner, inner + rows.start] = 1
        inverse = 1 / np.sqrt(np.maximum(square, 1e-20))
        towards = (normals[rows] @ places.T - heights[rows, None]) * inverse
        outward = (heights - places[rows] @ normals.T) * inverse
        return inverse, towards, outward, 3 * towards * outward - normals[rows] @ normals.T

    def _closed(self) -> np.ndarray:
        """Return (2, N): what the static D' and H of each triangle lack on itself.

        On a closed surface D' of any source flows out by half, whatever the source: the areas times D' sum to
        minus a half of each area. H of a constant is 0. Both are exact, and hold for flat triangles only if a
        triangle's own integral makes up for the others'.
        """
        mesh, near, count = self.triangles, self._near, len(self)
        share = (mesh.area / (4 * np.pi)).astype(np.float32)
        flow, bent = np.zeros(count), np.zeros(count)
        for start in range(0, count, _ROWS):
            rows = slice(start, min(start + _ROWS, count))
            inner = np.arange(rows.stop - rows.start)
            inverse, towards, _, bend = self._seen(rows)
            pairs = slice(near.starts[rows.start], near.starts[rows.stop])
            place = near.rows[pairs] - start, near.columns[pairs]
            for kernel, static in ((inverse**2 * towards, 2), (-(inverse**3) * bend, 3)):
                kernel *= share
                kernel[place] = near.static[static, pairs]
                kernel[inner, inner + start] = 0
                if static == 2:
                    flow += mesh.area[rows] @ kernel
                else:
                    bent[rows] = kernel.sum(1)
        radius, angle = self._own
        own = -(angle / radius).sum(1) / (4 * np.pi)
        return np.stack([-0.5 - flow / mesh.area, -bent - own])

    def _near_pairs(self) -> _Near:
        mesh = self.triangles
        tree = cKDTree(mesh.centroid)
        pairs = tree.query_pairs(NEAR_DISTANCE * self.mean_edge, output_type="ndarray")
        rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
        order = np.lexsort((columns, rows))
        rows, columns = rows[order], columns[order]
        starts = np.searchsorted(rows, np.arange(len(self) + 1))
        points, normals = mesh.centroid[rows], mesh.normal[rows]
        static = static_integrals(mesh.corners[columns], mesh.normal[columns], points, normals)
        away = mesh.quadrature()[:, columns] - points
        distance = np.linalg.norm(away, axis=2)
        return _Near(
            rows,
            columns,
            starts,
            static,
            *(
                each.astype(np.float32)
                for each in (
                    distance,
                    (away * normals).sum(2) / distance,
                    (away * mesh.normal[columns]).sum(2) / distance,
                    (normals * mesh.normal[columns]).sum(1),
                    mesh.area[columns] / len(away),
                )
            ),
        )

    def _near_integrals(self, k: float) -> np.ndarray:
        """Integrals (4, P) complex64: static ones exactly, the rest, which is smooth, by quadrature."""
        near = self._near
        r, out = near.distance, np.empty(near.static.shape, np.complex64)
        z, share = np.float32(k) * r, near.weight / (np.float32(4 * np.pi) * r)
        cosine, sine = np.cos(z), np.sin(z)
        # Real parts of the wave exp(i z) and of -i times it, less those at k = 0; then the imaginary ones.
        for part, wave, turned, still in ((out.real, cosine, sine, 1), (out.imag, sine, -cosine, 0)):
            slope = (still - wave - z * turned) / r
            bend = ((3 - z * z) * wave + 3 * (z * turned - still)) * near.both
            rest = (
                wave - still,
                slope * near.outward,
                -slope * near.towards,
                -(bend / r + slope * near.aligned) / r,
            )
            for integral, each in zip(part, rest, strict=True):
                integral[:] = (share * each).sum(0)
        out.real += near.static
        return out

    def _own_integrals(self, k: float) -> tuple[np.ndarray, np.ndarray]:
        """Single layer and hypersingular integral of each triangle at its own centroid, exactly.

        Terai, Journal of Sound and Vibration 69, 1980: radial integrals in closed form, over angles by Gauss.
        """
        radius, angle = self._own
        wave = np.exp(1j * k * radius)
        single = ((wave - 1) / (1j * k) * angle).sum(1) / (4 * np.pi)
        return single, 0.5j * k - (wave / radius * angle).sum(1) / (4 * np.pi)


def _vertex_means(faces: np.ndarray) -> csr_array:
    """Matrix (N, V) of the means of triangles over the values of the vertices in use, float32."""
    used, corners = np.unique(faces, return_inverse=True)
    rows = np.repeat(np.arange(len(faces)), 3)
    share = np.full(len(rows), 1 / 3, np.float32)
    return csr_array((share, (rows, corners.ravel())), (len(faces), len(used)))


def _own_edges(mesh: Triangles) -> tuple[np.ndarray, np.ndarray]:
    """Distances from centroids to Gauss points on the edges, and the angles that these stand for."""
    x, w = np.polynomial.legendre.leggauss(_EDGE_POINTS)
    begin = mesh.corners - mesh.centroid[:, None]
    edge = np.roll(begin, -1, axis=1) - begin
    points = begin[:, :, None] + edge[:, :, None] * ((x + 1) / 2)[:, None]
    radius = np.linalg.norm(points, axis=3)
    twice = np.linalg.norm(np.cross(begin, edge), axis=2)  # of the area between centroid and edge
    angle = twice[:, :, None] / radius**2 * w / 2
    return radius.reshape(len(edge), -1), angle.reshape(len(edge), -1)
