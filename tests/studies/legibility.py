"""Size of the letters of a figure on a narrow screen."""

from granflow.studies.figures import styled_figure

SCREEN = 378
"""Width of a figure [pixels] on a page in a window of 400 pixels."""


def smallest_letters(drawing):
    """Smallest size of the letters of a drawing [pixels], and its number of columns of panels, on a narrow
    screen."""
    from matplotlib.text import Text

    with styled_figure((drawing.width, drawing.height), layout="constrained") as figure:
        drawing.draw(figure)
        figure.canvas.draw()
        shown = [each for each in figure.findobj(Text) if each.get_visible() and each.get_text().strip()]
        size = min(each.get_fontsize() for each in shown)
        columns = len({round(axes.get_position().x0, 2) for axes in figure.axes})
    return SCREEN * size / (72.0 * drawing.width), columns
