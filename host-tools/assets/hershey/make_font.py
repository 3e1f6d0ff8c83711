#!/usr/bin/env python3
"""Makes single-stroke.ttf of futural.jhf: `pip install fonttools && python3 make_font.py`.

Every glyph is the pen's way as it is: a contour's points in order, without the way back. A program that closes contours
(all that know TrueType) would draw that way back; etherpen leaves it out. Letters with marks are made of a letter and
strokes of the marks below; what looks alike (quotation marks, dashes) shares a glyph.

A line of futural.jhf holds five characters of number, three with the count of pairs, then pairs of characters: left and
right edge first, then x and y of each point, all from 'R'; " R" lifts the pen. y points down, the baseline is at 9, capital
letters reach -12.
"""

import unicodedata
from pathlib import Path

from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen

HERE = Path(__file__).parent
UNITS_PER_EM = 1000
# Capital letters are 21 units high and 0.72 of the size, as in most sans-serif fonts.
SCALE = 0.72 * UNITS_PER_EM / 21
BASELINE = 9

# Marks: combining character -> strokes around the letter's middle, in Hershey's units above the letter's top (below the
# baseline for the cedilla).
MARKS = {
    "\u0300": [[(-3, 7), (1, 3)]],
    "\u0301": [[(3, 7), (-1, 3)]],
    "\u0302": [[(-4, 3), (0, 7), (4, 3)]],
    "\u0303": [[(-5, 3), (-3, 5), (-1, 5), (1, 4), (3, 4), (5, 6)]],
    "\u0304": [[(-4, 4), (4, 4)]],
    "\u0306": [[(-4, 7), (-3, 4), (-1, 3), (1, 3), (3, 4), (4, 7)]],
    "\u0307": [[(0, 4), (0, 5)]],
    "\u0308": [[(-4, 4), (-4, 5)], [(4, 4), (4, 5)]],
    "\u030a": [[(0, 2), (-2, 3), (-3, 5), (-2, 7), (0, 8), (2, 7), (3, 5), (2, 3), (0, 2)]],
    "\u030b": [[(-1, 7), (-4, 3)], [(4, 7), (1, 3)]],
    "\u030c": [[(-4, 7), (0, 3), (4, 7)]],
}
BELOW = {
    "\u0327": [[(0, 0), (1, -2), (2, -3), (1, -5), (-2, -5)]],
    "\u0328": [[(3, 0), (1, -3), (2, -5), (4, -5)]],
}
# Height of small letters; of i and j, the dot is above it.
SMALL_LETTER = 14
SAME = {
    "\u00a0": " ", "\u2018": "'", "\u2019": "'", "\u201a": ",", "\u201c": '"', "\u201d": '"', "\u201e": '"',
    "\u2010": "-", "\u2011": "-", "\u2013": "-", "\u2014": "-", "\u2212": "-", "\u00d7": "x", "\u2032": "'", "\u2033": '"',
}
SHARP_S = [[(5, 0), (5, 16), (6, 19), (9, 21), (12, 21), (14, 19), (14, 16), (12, 13), (10, 12), (13, 11), (16, 8), (16, 4), (14, 1), (11, 0), (8, 0)]]
DEGREE = [[(4, 21), (2, 20), (1, 18), (2, 16), (4, 15), (6, 16), (7, 18), (6, 20), (4, 21)]]


def read(path):
    """Character -> (left edge, right edge, strokes with y upwards from the baseline)."""
    glyphs = {}
    # A glyph of more than 36 pairs goes on in the next line.
    lines, text = [], path.read_text().splitlines()
    while text:
        line = text.pop(0)
        if not line.strip():
            continue
        count = int(line[5:8])
        while len(line) - 8 < 2 * count and text:
            line += text.pop(0)
        lines.append((count, line[8:8 + 2 * count]))
    for code, (count, pairs) in enumerate(lines, start=32):
        numbers = [ord(c) - ord("R") for c in pairs]
        left, right = numbers[0], numbers[1]
        strokes, stroke = [], []
        for k in range(1, count):
            if pairs[2 * k:2 * k + 2] == " R":
                strokes.append(stroke)
                stroke = []
            else:
                stroke.append((numbers[2 * k] - left, BASELINE - numbers[2 * k + 1]))
        strokes.append(stroke)
        glyphs[chr(code)] = (0, right - left, [s for s in strokes if s])
    return glyphs


def composed(glyphs):
    """Adds letters with marks, signs and what looks alike."""
    for code in list(range(0xC0, 0x180)) + [0x218, 0x219, 0x21A, 0x21B]:
        parts = unicodedata.normalize("NFD", chr(code))
        base, marks = parts[0], parts[1:]
        if base not in glyphs or not marks or not all(m in MARKS or m in BELOW for m in marks):
            continue
        left, right, strokes = glyphs[base]
        top = max(y for s in strokes for _, y in s)
        if base in "ij" and any(m in MARKS for m in marks):
            strokes = [s for s in strokes if max(y for _, y in s) <= SMALL_LETTER]
            top = SMALL_LETTER
        middle = (left + right) / 2
        strokes = list(strokes)
        for mark in marks:
            if mark in MARKS:
                strokes += [[(middle + x, top + y) for x, y in s] for s in MARKS[mark]]
            else:
                strokes += [[(middle + x, y) for x, y in s] for s in BELOW[mark]]
        glyphs[chr(code)] = (left, right, strokes)
    glyphs["\u00df"] = (0, 20, SHARP_S)
    glyphs["\u00b0"] = (0, 9, DEGREE)
    dots = glyphs["."]
    glyphs["\u2026"] = (0, 3 * dots[1], [[(x + k * dots[1], y) for x, y in s] for k in range(3) for s in dots[2]])
    for char, like in SAME.items():
        glyphs[char] = glyphs[like]
    del glyphs["\x7f"]
    return glyphs


def outline(strokes):
    pen = TTGlyphPen(None)
    for stroke in strokes:
        points = [(round(x * SCALE), round(y * SCALE)) for x, y in stroke]
        if len(points) < 2:
            continue
        pen.moveTo(points[0])
        for point in points[1:]:
            pen.lineTo(point)
        if points[0] == points[-1]:
            # The pen leaves out a last point that is the first one; a ring needs it.
            pen.lineTo(points[0])
        pen.closePath()
    return pen.glyph(dropImpliedOnCurves=False)


def main():
    glyphs = composed(read(HERE / "futural.jhf"))
    names = {char: f"u{ord(char):04X}" for char in sorted(glyphs)}
    builder = FontBuilder(UNITS_PER_EM, isTTF=True)
    builder.setupGlyphOrder([".notdef"] + list(names.values()))
    builder.setupCharacterMap({ord(char): name for char, name in names.items()})
    outlines = {name: outline(glyphs[char][2]) for char, name in names.items()}
    # What is missing is seen.
    outlines[".notdef"] = outline([[(2, 0), (12, 0), (12, 21), (2, 21), (2, 0)]])
    builder.setupGlyf(outlines)
    metrics = {name: round(glyphs[char][1] * SCALE) for char, name in names.items()} | {".notdef": round(14 * SCALE)}
    # Without its own left edge as bearing a glyph would be shifted.
    edges = {name: getattr(builder.font["glyf"][name], "xMin", 0) for name in metrics}
    builder.setupHorizontalMetrics({name: (width, edges[name]) for name, width in metrics.items()})
    builder.setupHorizontalHeader(ascent=800, descent=-250)
    builder.setupOS2(sTypoAscender=800, sTypoDescender=-250, sxHeight=480, sCapHeight=720)
    name = "Etherpen Single Stroke"
    builder.setupNameTable(
        {"familyName": name, "styleName": "Regular", "fullName": name, "psName": name.replace(" ", ""), "uniqueFontIdentifier": name}
    )
    builder.setupPost()
    builder.font.recalcTimestamp = False
    builder.font["head"].created = builder.font["head"].modified = 0
    builder.save(HERE / "single-stroke.ttf")


if __name__ == "__main__":
    main()
