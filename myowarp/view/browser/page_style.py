"""Style of a page beyond viser's options: rules for the classes of Mantine, with which it is made.

Where a class gets another name, its rule does nothing.
"""

from myowarp.view.drawing.style import SKY_RGB

TRACES = "myowarp-traces"
"""Class of what the window of traces shows."""
STYLE = f"""<style>
canvas {{ opacity: 1 !important; }}
canvas[data-engine] {{ background: rgb({", ".join(f"{255 * share:.0f}" for share in SKY_RGB)}); }}
.mantine-NumberInput-root {{ width: 4.4rem !important; }}
.mantine-Notifications-root {{ top: auto !important; bottom: 0.5rem !important; left: auto !important;
  right: 0.5rem !important; width: 19rem !important; transform: none !important; }}
.mantine-Paper-root:has(.{TRACES}) {{ max-width: calc(100% - 23em) !important; }}
#webgl-software-rendering, .myowarp-software {{ display: none; }}
body:has(#webgl-software-rendering) .myowarp-software {{ display: block; padding: 0 1rem 0.6rem;
  font-size: 0.75em; }}
</style>"""
"""The sky is behind what is drawn, and costs nothing there. The picture has its colours at once: viser fades
it in over five frames, seconds where software draws. Numbers fit into their boxes; notices stand in the
corner of the panel, off the picture; traces keep off the panel in a narrow window; what viser says of a
browser without a GPU becomes a line of the panel.
"""
SOFTWARE = (
    "<div class='myowarp-software' title='Its settings may have hardware acceleration turned off.'>"
    "Drawn without a GPU: few pictures a second.</div>"
)
