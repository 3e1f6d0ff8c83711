"""Judges drawings of photographs: `judge.py ORDERS.json` prints JSON.

The judge is dlib (HOG detector, 5 points, identity of 128 numbers), which no part of the vectoriser uses. In the orders a
photograph has `name`, `picture` (the part that is drawn), `subject` (a mask, or null) and `drawings`, a map from names to
pictures of the drawing's place on the sheet. Everything is scaled to a width of 800 pixels. The answer has for each
photograph `has_face` and for each drawing `tone` in the subject and in the face, `found` for each blur, and `distances` to
the photographs with a face for each blur, null where no face is found. `blank` has the distances of an empty sheet with the
photograph's box.
"""

import importlib.util, json, os, sys
import dlib
import numpy as np

TONE_SIGMA_PX = 8.0
OVERLAP_MIN = 0.3
# Slightly turned, moved and scaled pictures whose numbers are averaged: one alone differs by hundredths from the next.
JITTERS = 20
PAPER = 251

folder = os.path.join(importlib.util.find_spec("face_recognition_models").submodule_search_locations[0], "models")
detector = dlib.get_frontal_face_detector()
points = dlib.shape_predictor(os.path.join(folder, "shape_predictor_5_face_landmarks.dat"))
outline = dlib.shape_predictor(os.path.join(folder, "shape_predictor_68_face_landmarks.dat"))
network = dlib.face_recognition_model_v1(os.path.join(folder, "dlib_face_recognition_resnet_model_v1.dat"))


def faces(picture):
    found = detector(picture, 0)
    return sorted(found, key=lambda box: -box.area())


def identity(picture, box):
    return np.array(network.compute_face_descriptor(picture, points(picture, box), JITTERS))


def overlap(a, b):
    shared = a.intersect(b).area()
    return shared / (a.area() + b.area() - shared)


def face_mask(picture, box):
    """Oval of a face from brows to chin, as wide as its jaw."""
    shape = outline(picture, box)
    jaw = np.array([[shape.part(k).x, shape.part(k).y] for k in range(27)], np.int32)
    mask = np.zeros(picture.shape[:2], np.float32)
    cv2.fillConvexPoly(mask, cv2.convexHull(jaw), 1.0)
    return mask


def grey(picture):
    return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)


def tone(photograph, drawing, mask):
    """Correlation of the blurred tones, weighted by the mask."""
    a, b = (cv2.GaussianBlur(grey(picture), (0, 0), TONE_SIGMA_PX) for picture in (photograph, drawing))
    weight = mask / mask.sum()
    a, b = a - (a * weight).sum(), b - (b * weight).sum()
    square = (a * a * weight).sum() * (b * b * weight).sum()
    return float((a * b * weight).sum() / np.sqrt(square)) if square > 1e-9 else 0.0


def judged(photograph, order, known):
    picture, box = photograph["picture"], photograph["box"]

    def distances(drawn, place):
        own = identity(drawn, place)
        return {name: float(np.linalg.norm(own - other)) for name, other in known.items()}

    answer = {"name": order["name"], "has_face": box is not None, "drawings": {}, "blank": None}
    subject = np.ones(picture.shape[:2], np.float32)
    if order["subject"]:
        mask = cv2.imread(order["subject"], cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
        subject = cv2.resize(mask, (picture.shape[1], picture.shape[0]))
    if box is not None:
        answer["blank"] = distances(np.full_like(picture, PAPER), box)
    for name, path in order["drawings"].items():
        drawing = cv2.resize(read(path), (picture.shape[1], picture.shape[0]))
        result = {"tone_subject": tone(picture, drawing, subject), "tone_face": None, "found": [], "distances": []}
        if box is not None:
            result["tone_face"] = tone(picture, drawing, face_mask(picture, box))
            for blur in BLURS_PX:
                seen = cv2.GaussianBlur(drawing, (0, 0), blur)
                same = [place for place in faces(seen) if overlap(place, box) >= OVERLAP_MIN]
                result["found"].append(bool(same))
                result["distances"].append(distances(seen, same[0]) if same else None)
        answer["drawings"][name] = result
    return answer


orders = json.load(open(sys.argv[1]))
photographs, known = [], {}
for order in orders:
    picture = read(order["picture"])
    box = next(iter(faces(picture)), None)
    photographs.append({"picture": picture, "box": box})
    if box is not None:
        known[order["name"]] = identity(picture, box)
print(json.dumps([judged(*pair, known) for pair in zip(photographs, orders)]))
