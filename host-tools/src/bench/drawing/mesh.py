"""Judges faces in drawings by their landmarks: `mesh.py ORDERS.json` prints JSON.

The judge is mediapipe's face mesh (468 points), which no part of the vectoriser uses. The orders are those of `judge.py`.
The answer has for each photograph null, if no face is found in it, or a map from the names of its drawings to a list: for
each blur how far the drawing's points are from the photograph's in the mean, as a share of the distance between the outer
corners of the eyes; null where the drawing shows no face in that place.
"""

import json, sys
import numpy as np
from mediapipe.python.solutions.face_mesh import FaceMesh

OUTER_CORNERS = [33, 263]
# Farther away, it is another face.
ERROR_MAX = 0.5


def meshes(judge, picture):
    """Points of each face, pixels."""
    size = np.array([picture.shape[1], picture.shape[0]])
    found = judge.process(picture).multi_face_landmarks or []
    return [np.array([(point.x, point.y) for point in face.landmark]) * size for face in found]


def between_eyes(points):
    a, b = points[OUTER_CORNERS]
    return float(np.linalg.norm(a - b))


def error(judge, drawing, known):
    errors = [np.linalg.norm(points - known, axis=1).mean() / between_eyes(known) for points in meshes(judge, drawing)]
    best = min(errors, default=ERROR_MAX)
    return float(best) if best < ERROR_MAX else None


def judged(judge, order):
    picture = read(order["picture"])
    known = max(meshes(judge, picture), key=between_eyes, default=None)
    if known is None:
        return None
    size = (picture.shape[1], picture.shape[0])
    drawings = {name: cv2.resize(read(path), size) for name, path in order["drawings"].items()}
    blurred = lambda drawing: [cv2.GaussianBlur(drawing, (0, 0), blur) for blur in BLURS_PX]
    return {name: [error(judge, seen, known) for seen in blurred(drawing)] for name, drawing in drawings.items()}


with FaceMesh(static_image_mode=True, max_num_faces=10) as judge:
    print(json.dumps([judged(judge, order) for order in json.load(open(sys.argv[1]))]))
