"""Review of a labelled survey: the page in the browser, and the corrections."""
