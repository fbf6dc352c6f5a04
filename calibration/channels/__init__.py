"""Estimation and correction of the complex gains and delays of Tx and Rx channels."""
