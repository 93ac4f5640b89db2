"""Pictures of rates, attitudes and errors: PNG, SVG, PDF, or a report as one HTML file.

Samples are reduced while they are read (:mod:`~quatprop.tools.plot.reduction`), so memory stays
constant however long a log is. The content of a picture (:mod:`~quatprop.tools.plot.picture`) is
independent of the drawing of its panels (:mod:`~quatprop.tools.plot.panels`) and of the figure
(:mod:`~quatprop.tools.plot.figure`), and of the page around it (:mod:`~quatprop.tools.plot.page`).
"""
