// SPDX-License-Identifier: MIT
// A row of a layer: sums of products, PRODUCTS of them a cycle, and what these sums become.
//
// Nothing in it can stall, and nothing in it is reset: what goes through is told by its user's own delays.
module pearl_lane
  import pearl_pkg::*;
#(
    parameter  int unsigned PRODUCTS    = 4,
    parameter  int unsigned WEIGHT_BITS = 8,
    parameter int unsigned VALUE_BITS = 12
) (
    input  logic                                     clk_i,
    input  logic   [  PRODUCTS-1:0][WEIGHT_BITS-1:0] weights_i,
    input  logic   [  PRODUCTS-1:0][ VALUE_BITS-1:0] values_i,
    // As many cycles later as the products take to be added, and one: whether these are the first products of a sum, and its bias.
    input  logic                                     first_i,
    input  logic   [  SUM_BITS-1:0]                  bias_i,
    // A cycle later.
    output logic   [  SUM_BITS-1:0]                  sum_o,
    // Of the layer, as long as its sums become values: LANE_VALUE cycles after the sum.
    input  layer_t                                   layer_i,
    output logic   [VALUE_BITS-1:0]                  value_o,
    input  logic                                     table_we_i,
    input  logic   [ENTRY_BITS-1:0]                  table_addr_i,
    input  logic   [VALUE_BITS-1:0]                  table_wdata_i
);

  localparam int unsigned PRODUCT_BITS = WEIGHT_BITS + VALUE_BITS;
  localparam logic signed [SUM_BITS-1:0] HALF = SUM_BITS'(ENTRIES / 2);

  logic [PRODUCTS-1:0][PRODUCT_BITS-1:0] products_q;
  logic [PRODUCT_BITS+$clog2(PRODUCTS)-1:0] added;

  always_ff @(posedge clk_i) begin
    for (int unsigned i = 0; i < PRODUCTS; i++) begin
      products_q[i] <= PRODUCT_BITS'($signed(weights_i[i])) * PRODUCT_BITS'($signed(values_i[i]));
    end
  end

  pearl_sum #(
      .TERMS(PRODUCTS),
      .WIDTH(PRODUCT_BITS)
  ) u_sum (
      .clk_i,
      .terms_i(products_q),
      .sum_o  (added)
  );

  logic signed [SUM_BITS-1:0] sum_q, shifted_q;
  always_ff @(posedge clk_i) begin
    sum_q     <= $signed(first_i ? bias_i : sum_q) + SUM_BITS'($signed(added));
    shifted_q <= sum_q >>> layer_i.shift;
  end
  assign sum_o = sum_q;

  // ---- What a sum becomes ----

  logic signed [SUM_BITS-1:0] limit;
  logic unused_layer;
  assign unused_layer = ^layer_i;
  logic [VALUE_BITS-1:0] limited_q, limited, looked_up, value_q;
  logic [ENTRY_BITS-1:0] entry_q;

  assign limit = SUM_BITS'(layer_i.limit);

  // Entries are those of sums from -ENTRIES / 2 on: the highest bit of the index is the sign, inverted.
  always_ff @(posedge clk_i) begin
    if (shifted_q < 0) limited_q <= '0;
    else if (shifted_q > limit) limited_q <= limit[VALUE_BITS-1:0];
    else limited_q <= shifted_q[VALUE_BITS-1:0];
    if (shifted_q < -HALF) entry_q <= '0;
    else if (shifted_q >= HALF) entry_q <= '1;
    else entry_q <= {!shifted_q[ENTRY_BITS-1], shifted_q[ENTRY_BITS-2:0]};
  end

  pearl_delay #(
      .WIDTH (VALUE_BITS),
      .STAGES(READ_LATENCY)
  ) u_limited (
      .clk_i,
      .d_i(limited_q),
      .d_o(limited)
  );

  pearl_ram #(
      .WIDTH(VALUE_BITS),
      .DEPTH(ENTRIES)
  ) u_table (
      .clk_i,
      .we_i   (table_we_i),
      .waddr_i(table_addr_i),
      .wdata_i(table_wdata_i),
      .re_i   (layer_i.tabled),
      .raddr_i(entry_q),
      .rdata_o(looked_up)
  );

  always_ff @(posedge clk_i) value_q <= layer_i.tabled ? looked_up : limited;
  assign value_o = value_q;

endmodule
