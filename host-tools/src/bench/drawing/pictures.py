"""How the judges of drawings read pictures; stands before each of them."""

import cv2

WIDTH_PX = 800
BLURS_PX = [2.0, 4.0]


def read(path):
    picture = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
    height = round(picture.shape[0] * WIDTH_PX / picture.shape[1])
    return cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)


