"""Draws a photograph with other programs: a line of JSON for each line of JSON.

In: `peer`, `picture` (a file), `size_mm` of the drawing, `pen_mm`, and `spacing` of its lines in mm; contours have
12 levels at a spacing of 1.
Out: `strokes` in mm from the picture's upper left corner and `cpu_s`, or `error`.
"""

import contextlib, io, json, os, sys, time

ANSWERS = os.fdopen(os.dup(1), "w")
with contextlib.redirect_stdout(sys.stderr):
    import cv2, hatched, plotline


def hatched_lines(order):
    pixels = cv2.imread(order["picture"]).shape[1]
    mm = order["size_mm"][0] / pixels
    # It prints what went wrong and returns no lines.
    with contextlib.redirect_stdout(io.StringIO()) as said:
        lines = hatched.hatch(order["picture"], hatch_pitch=order["spacing"] / mm, show_plot=False, save_svg=False)
    errors = [line for line in said.getvalue().splitlines() if line.startswith("Error:")]
    if errors:
        raise RuntimeError("; ".join(errors))
    return [[[x * mm, y * mm] for x, y in line.coords] for line in lines.geoms]


def plotline_lines(order, style, stage, settings):
    session = plotline.Session()
    session.set_image(cv2.cvtColor(cv2.imread(order["picture"]), cv2.COLOR_BGR2RGB))
    session.set_canvas(plotline.Canvas(*order["size_mm"]))
    session.set_pens([plotline.Pen("pen", order["pen_mm"], "#000000")])
    session.set_style(style)
    session.update(stage, **settings)
    drawing = session.run_blocking()
    return [path.tolist() for layer in drawing.layers for path in layer.paths]


def lines(order):
    if order["peer"] == "hatched":
        return hatched_lines(order)
    if order["peer"] == "plotline hatch":
        return plotline_lines(order, "hatch", "hatch", {"spacing_mm": order["spacing"]})
    levels = max(1, min(64, round(12 / order["spacing"])))
    return plotline_lines(order, "contours", "contours", {"levels": levels})


for line in sys.stdin:
    order = json.loads(line)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            begun = time.process_time()
            strokes = lines(order)
            answer = {"strokes": strokes, "cpu_s": time.process_time() - begun}
    except Exception as error:
        answer = {"error": f"{type(error).__name__}: {error}"}
    ANSWERS.write(json.dumps(answer) + "\n")
    ANSWERS.flush()
