"""Hostile input for every reader: `targets` lists them, `seeds` and `mutators` make the inputs,
`harness` reads and judges them (CONTRIBUTING.md).
"""
