"""The paper's experiments (Caggiano et al. 2022, arXiv:2205.13600), each one file: `myowarp reproduce NAME`.

The Markdown file of the same name has the protocol, with what the paper leaves open and how we chose. The
file ends with

    EXPERIMENT = Experiment(name, run)

which `catalog` lists. `run` takes a `Lab`, which keeps every finished run and knows the policies, and returns
`Findings`: figures of merit beside the paper's, claims, text, and a figure. `report` writes them.
"""
