"""Pictures of rates, attitudes and errors: PNG, SVG, PDF, or a report as one HTML file.

Samples are reduced while they are read (:mod:`~quatprop.plot.reduction`), so memory stays constant
however long a log is. The content of a picture (:mod:`~quatprop.plot.picture`) is independent of
the drawing (:mod:`~quatprop.plot.draw`) and of the page around it (:mod:`~quatprop.plot.page`).
"""
