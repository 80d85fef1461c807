"""Policies: trained bundles and classical controllers."""
