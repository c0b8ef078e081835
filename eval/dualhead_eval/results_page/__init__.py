"""docs/results.md, written from a template and the committed results.

python -m dualhead_eval.results_page            # write it
python -m dualhead_eval.results_page --check    # fail if it is not what the results give
"""
