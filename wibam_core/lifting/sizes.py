"""One size per vehicle: what all sightings of a track say together."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from wibam_core.lifting.fit import LOG_HEIGHT, LOG_LENGTH, LOG_WIDTH, YAW, X, Y
from wibam_core.lifting.trajectory import Tracks
from wibam_core.scene import FloatArray

_ROBUST_SD = 2.0
_PASSES = 4
#: The errors of one vehicle's sightings are alike (its body differs from the template in each of them, and detectors
#: err for seconds in the same way), so that all of them count as no more than this many independent ones.
_INDEPENDENT_SIGHTINGS = 4.0
#: Sightings within this distance of each other show the same sides of a vehicle, hidden by the same others: the many
#: sightings of a waiting vehicle count as no more than this many at other places.
_PLACE_M, _SIGHTINGS_OF_PLACE = 2.0, 3.0


def size_information(information: FloatArray) -> FloatArray:
    """(N, 3, 3) information on log sizes alone, of (N, 6, 6) on x, y, log sizes, yaw: position and yaw marginalised."""
    sizes, others = [LOG_LENGTH, LOG_WIDTH, LOG_HEIGHT], [X, Y, YAW]
    a = information[:, sizes][:, :, sizes]
    b = information[:, sizes][:, :, others]
    c = information[:, others][:, :, others] + 1e-6 * np.eye(3)
    marginal = a - b @ np.linalg.solve(c, b.transpose(0, 2, 1))
    marginal = 0.5 * (marginal + marginal.transpose(0, 2, 1))
    values, vectors = np.linalg.eigh(marginal)
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None]) @ vectors.transpose(0, 2, 1))


def track_sizes(
    tracks: Tracks,
    log_sizes: FloatArray,
    information: FloatArray,
    prior_mean: FloatArray,
    prior_sd: FloatArray,
    places: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Combine sightings.

    Args:
        tracks: how the observations form tracks.
        log_sizes: (N, 3) single fits, each made under the prior.
        information: (N, 3, 3) of their views alone.
        prior_mean: (N, 3) of log sizes, equal within a track.
        prior_sd: (N, 3) of log sizes, equal within a track.
        places: (N, 2) where the vehicles were, m.

    Returns:
        (M, 3) log sizes of the tracks and (M, 3, 3) covariances.
    """
    precision = prior_sd[tracks.rows[:, 0]][:, :, None] ** -2.0 * np.eye(3) if len(tracks.rows) else np.empty((0, 3, 3))
    mean = prior_mean[tracks.rows[:, 0]] if len(tracks.rows) else np.empty((0, 3))
    own_prior = prior_sd[:, :, None] ** -2.0 * np.eye(3)
    # a fit is (Λ s + Λ0 μ) / (Λ + Λ0): recover Λ s of the views alone
    message = (((information + own_prior) @ log_sizes[..., None]) - own_prior @ prior_mean[..., None])[..., 0]
    weight = tracks.valid.astype(np.float64)
    own_share = np.minimum(1.0, _SIGHTINGS_OF_PLACE / _sightings_near(tracks, places))
    lam, eta = information[tracks.rows], message[tracks.rows]
    estimate = mean
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    single = log_sizes[tracks.rows]
    spread = np.linalg.inv(lam + precision[:, None]) if len(tracks.rows) else lam
    for _ in range(_PASSES):
        share = weight * own_share
        share *= np.minimum(1.0, _INDEPENDENT_SIGHTINGS / np.maximum(share.sum(axis=1, keepdims=True), 1e-9))
        total = precision + np.einsum("mt,mtij->mij", share, lam)
        covariance = np.asarray(np.linalg.inv(total), dtype=np.float64)
        pull = (precision @ mean[..., None])[..., 0] + np.einsum("mt,mti->mi", share, eta)
        estimate = (covariance @ pull[..., None])[..., 0]
        off = single - estimate[:, None]
        squared = np.einsum("mti,mtij,mtj->mt", off, np.linalg.inv(spread), off) / 3
        weight = tracks.valid / (1 + squared / _ROBUST_SD**2)
    return estimate, covariance


def _sightings_near(tracks: Tracks, places: FloatArray) -> FloatArray:
    """(M, T) how many sightings of its track were made near the place of each, itself included; 1 where padded."""
    count = np.ones(tracks.valid.shape)
    for k, sightings in enumerate(tracks.valid.sum(axis=1).tolist()):
        own = places[tracks.rows[k, :sightings]]
        count[k, :sightings] = cKDTree(own).query_ball_point(own, _PLACE_M, return_length=True)
    return count
