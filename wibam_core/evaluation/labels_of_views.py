"""Hand labels say how much a camera sees of a vehicle; here, how much each view that is cut from its picture does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from wibam_core.geometry.boxes2d import areas_px2
from wibam_core.geometry.projection import project_boxes
from wibam_core.scene import CameraRig, LabelledInstant


def labels_of_views(labels: Iterable[LabelledInstant], rig: CameraRig) -> list[LabelledInstant]:
    """Labels with a visibility for every view: that of its camera, times the share of the box that the view shows.

    Args:
        labels: with the visibility by mounted camera.
        rig: where it has no views, labels stay as they are.
    """
    return [_of_views(label, rig) for label in labels] if rig.views else list(labels)


def _of_views(label: LabelledInstant, rig: CameraRig) -> LabelledInstant:
    visibility = {id_: seen for id_, seen in label.visibility.items() if id_ not in rig.views}
    for camera_id, views in rig.views.items():
        if camera_id not in label.visibility:
            continue
        for view in views:
            within = project_boxes(rig[view.id], label.vehicles.boxes)
            whole = project_boxes(rig[view.id], label.vehicles.boxes, clamp=False)
            with np.errstate(divide="ignore", invalid="ignore"):
                shown = np.nan_to_num(areas_px2(within) / areas_px2(whole))
            visibility[view.id] = np.asarray(label.visibility[camera_id]) * shown
    return replace(label, visibility=visibility)
