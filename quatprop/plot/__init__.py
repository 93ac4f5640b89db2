"""Pictures of rates, attitudes and errors: PNG, SVG, PDF, or a report as one HTML file.

What passes is reduced while it is read (:mod:`~quatprop.plot.reduction`), so memory stays flat
however long a log is. What is drawn (:mod:`~quatprop.plot.picture`) knows nothing of how it is
drawn (:mod:`~quatprop.plot.draw`), nor of the page around it (:mod:`~quatprop.plot.page`).
"""
