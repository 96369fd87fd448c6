"""Every statement of the protocol page is held by a test, or is plain from a definition."""

import re
from pathlib import Path

import numpy as np

from artifact import STD
from artifact.studies.protocol import decisions

TESTS = {
    "Positive": [
        "test_counts_equal_a_literal_sort_of_the_augmented_database",
        "test_pairs_need_partners_of_the_same_name",
    ],
    "Excluded queries": [
        "test_counts_equal_a_literal_sort_of_the_augmented_database",
        "test_counting_queries_without_a_positive_differs",
    ],
    "Distractors of a query": [
        "test_counts_equal_a_literal_sort_property",
        "test_a_right_run_is_equal_and_planted_errors_differ",
    ],
    "Similarity": ["test_similarities_rank_as_defined"],
    "Rank of the best positive": ["test_counts_equal_a_literal_sort_of_the_augmented_database"],
    "R@K, DAR@K, RSR@K": ["test_counts_equal_a_literal_sort_of_the_augmented_database", "test_rsr_is_dar_over_recall"],
    "Mean over datasets": ["test_means_are_over_the_six_datasets", "test_ranks_follow_the_means"],
    "Number sweep": [
        "test_expected_number_sweep_is_the_mean_over_all_subsets",
        "test_nested_draws_average_to_the_expectation",
    ],
    "Distance sweep": [
        "test_counts_equal_a_literal_sort_of_the_augmented_database",
        "test_sweeps_end_at_recall_and_dar",
    ],
    "Condition sweep": ["test_several_pools_share_one_pass", "test_a_larger_pool_counts_as_the_mean_of_smaller_ones"],
    "Mixed database (Figs. 2, 9)": ["test_mixed_databases_count_added_images_within_the_threshold_as_right"],
    "Fitting region": [
        "test_the_centre_holds_the_queries_nearest_to_the_mean",
        "test_the_edge_is_a_slice_across_the_longest_direction",
    ],
    "Evaluation region": ["test_regions_share_no_place"],
    "INLP": [
        "test_the_classifier_is_the_one_of_scikit_learn",
        "test_inlp_in_sample_space_equals_the_direct_loop",
        "test_inlp_is_an_orthogonal_projection_of_its_rank",
    ],
    "INLP with few images": ["test_of_few_images_the_seed_decides_which_directions_go"],
    "LEACE": [
        "test_leace_equals_the_whitening_formula",
        "test_leace_tolerance_drops_directions_without_data",
        "test_leace_fitted_on_its_own_output_changes_nothing",
    ],
    "STD": ["test_std_gives_every_condition_mean_0_and_deviation_1"],
    "Guardedness probe": [
        "test_probe_halves_are_balanced_and_apart",
        "test_the_probe_is_the_default_classifier_on_the_transformed_descriptors",
        "test_a_probe_that_does_not_converge_says_so",
    ],
    "Several conditions": [
        "test_the_composed_transform_is_fitted_in_turn_and_erases_both_conditions",
        "test_composition_equals_applying_in_order",
        "test_places_of_every_fitting_region_stay_out_of_irrelevant_pairs",
    ],
    "Normalisation": [
        "test_views_equal_transforming_the_descriptors_first",
        "test_state_dict_and_output_have_the_released_shapes",
    ],
    "Image files": [
        "test_photographs_are_turned_upright",
        "test_what_is_transparent_lies_on_white",
        "test_sixteen_bits_are_scaled_and_other_ranges_refused",
        "test_raw_mosaics_are_refused_and_grey_photographs_are_not",
    ],
    "Image counts": ["test_other_counts_than_the_papers_are_said_and_do_not_stop"],
    "Input size": ["test_the_shipped_manifest_is_the_papers", "test_a_wrong_size_is_refused_with_the_rule"],
    "CricaVPR batches": ["test_batches_are_the_protocols_in_any_parts_and_after_any_stop"],
    "Re-ranking (SelaVPR, SelaVPR++)": [
        "test_ranks_and_sweeps_equal_the_definition",
        "test_studies_take_two_stage_methods_as_any_other",
    ],
    "Precision": ["test_float32_is_never_tf32", "test_another_dtype_is_another_result_but_the_descriptors_are_shared"],
    "Mean ± standard deviation (Tables IV, V)": [
        "test_the_composed_transform_is_fitted_in_turn_and_erases_both_conditions"
    ],
    "Intervals": [
        "test_replicates_are_means_of_circular_blocks_of_consecutive_queries",
        "test_the_interval_of_a_paired_difference_covers_the_truth_as_often_as_it_says",
    ],
}


def test_every_decision_has_its_tests_and_they_are_there():
    assert decisions()["topic"].tolist() == list(TESTS)
    written = "\n".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    there = set(re.findall(r"^def (test_\w+)", written, re.MULTILINE))
    assert {name for names in TESTS.values() for name in names} <= there


def test_standardising_in_place_gives_the_same_values():
    rng = np.random.default_rng(0)
    X, condition = rng.normal(size=(3000, 7)).astype(np.float32), np.arange(3000) % 2
    std = STD().fit(X, condition)
    expected, given = std.transform(X, condition), X.copy()
    assert std.transform(given, condition, copy=False) is given
    np.testing.assert_array_equal(given, expected)
    assert not np.shares_memory(expected, X)
