// SPDX-License-Identifier: MIT
// A lane of the policy engine adds up what it is said to: whatever operands come, a sum is its bias and all products
// since; and what becomes of it, where it is not looked up, is the shifted sum, cut.
module lane_proof
  import pearl_pkg::*;
#(
    parameter int unsigned PRODUCTS = 3,
    parameter int unsigned WEIGHT_BITS = 3,
    parameter int unsigned VALUE_BITS = 3
) (
    input logic                                 clk_i,
    input logic [PRODUCTS-1:0][WEIGHT_BITS-1:0] weights_i,
    input logic [PRODUCTS-1:0][ VALUE_BITS-1:0] values_i,
    input logic                                 first_i,
    input logic [SUM_BITS-1:0]                  bias_i,
    input logic [        63:0]                  layer_i
);

  localparam int unsigned TO_SUM = $clog2(PRODUCTS) + 1;
  localparam int unsigned LONGEST = TO_SUM + LANE_VALUE;

  // The layer is the same from the second cycle on.
  logic [63:0] held_q;
  logic held_valid_q = 1'b0;
  layer_t layer;
  always_comb begin
    layer = held_q;
    layer.tabled = 1'b0;
    layer.limit = 26'(held_q[32+:VALUE_BITS-1]);
  end

  always_ff @(posedge clk_i) begin
    if (!held_valid_q) held_q <= layer_i;
    held_valid_q <= 1'b1;
  end

  logic [  SUM_BITS-1:0] sum;
  logic [VALUE_BITS-1:0] value;
  pearl_lane #(
      .PRODUCTS   (PRODUCTS),
      .WEIGHT_BITS(WEIGHT_BITS),
      .VALUE_BITS (VALUE_BITS)
  ) u_lane (
      .clk_i,
      .weights_i,
      .values_i,
      .first_i,
      .bias_i,
      .sum_o        (sum),
      .layer_i      (layer),
      .value_o      (value),
      .table_we_i   (1'b0),
      .table_addr_i ('0),
      .table_wdata_i('0)
  );

  // What the operands of a cycle add, and how long ago that was.
  logic signed [SUM_BITS-1:0] added;
  logic [TO_SUM:1][SUM_BITS-1:0] added_q;
  always_comb begin
    added = '0;
    for (int unsigned i = 0; i < PRODUCTS; i++) begin
      added += SUM_BITS'($signed(weights_i[i])) * SUM_BITS'($signed(values_i[i]));
    end
  end

  logic [$clog2(LONGEST+1)-1:0] cycle_q = '0;
  logic known_q = 1'b0;
  logic [SUM_BITS-1:0] expected_q;
  logic [LANE_VALUE:1][SUM_BITS-1:0] sums_q;
  logic [LANE_VALUE:1] known_sums_q = '0;
  logic signed [SUM_BITS-1:0] shifted;

  always_ff @(posedge clk_i) begin
    if (32'(cycle_q) < LONGEST) cycle_q <= cycle_q + 1'b1;
    added_q    <= {added_q[TO_SUM-1:1], added};
    expected_q <= (first_i ? bias_i : expected_q) + added_q[TO_SUM];
    if (first_i && 32'(cycle_q) >= TO_SUM) known_q <= 1'b1;
    sums_q       <= {sums_q[LANE_VALUE-1:1], expected_q};
    known_sums_q <= {known_sums_q[LANE_VALUE-1:1], known_q};
  end

  assign shifted = $signed(sums_q[LANE_VALUE]) >>> layer.shift;

  always_ff @(posedge clk_i) begin
    if (known_q) summed : assert (sum == expected_q);
    if (known_sums_q[LANE_VALUE]) begin
      if (shifted < 0)
        below :
        assert (value == '0);
        else if (shifted > $signed(SUM_BITS'(layer.limit)))
          above :
          assert (value == layer.limit[VALUE_BITS-1:0]);
          else between : assert (SUM_BITS'(value) == shifted);
    end
  end

endmodule
