// SPDX-License-Identifier: MIT
// From the planes of a group's rows to inputs of a network: patches of 3 by 3 are multiplied by filters, shifted and
// cut at 0 and a limit. PRODUCTS filters of a patch a cycle, so that a group takes CHUNKS cycles.
//
// Planes are bits, so that a product is a weight or 0. All filters of a patch come before those of the next one.
module pearl_patches
  import pearl_pkg::*;
#(
    parameter int unsigned ROWS = 4,
    // Of a picture: its rows, its columns, and its planes, which are its last axis.
    parameter int unsigned HEIGHT = 4,
    parameter int unsigned WIDTH = 4,
    parameter int unsigned PLANES = 2,
    parameter int unsigned FILTERS = 4,
    parameter int unsigned PRODUCTS = 4,
    parameter int unsigned WEIGHT_BITS = 8,
    parameter int unsigned VALUE_BITS = 12,
    parameter int unsigned INDEX_BITS = 12,
    localparam int unsigned ELEMENTS = HEIGHT * WIDTH * PLANES
) (
    input logic clk_i,
    input logic rst_ni,

    // A filter has its weights and, behind them, its bias, from a multiple of a power of two on; filters of a word of
    // them likewise. The bias comes last: with it the filter is stored.
    input logic [NumSections-1:0] we_i,
    input logic [ INDEX_BITS-1:0] index_i,
    input logic [           31:0] wdata_i,

    // A group, every CHUNKS cycles at most; whether it is the last one.
    input logic                          valid_i,
    input logic                          last_i,
    input logic [ROWS-1:0][ELEMENTS-1:0] elements_i,

    output logic                                          valid_o,
    output logic                                          last_o,
    output logic [ROWS-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] values_o
);

  localparam int unsigned SIDE = 3;
  localparam int unsigned TAPS = SIDE * SIDE * PLANES;
  localparam int unsigned WORDS = ceil_div(FILTERS, PRODUCTS);
  localparam int unsigned PLACES = WIDTH - SIDE + 1;
  localparam int unsigned CHUNKS = (HEIGHT - SIDE + 1) * PLACES * WORDS;
  localparam int unsigned TAP_BITS = $clog2(TAPS + 1);
  localparam int unsigned COLUMN_BITS = $clog2(PRODUCTS);
  localparam int unsigned WORD_BITS = index_bits(WORDS);
  localparam int unsigned PLACE_BITS = index_bits(PLACES);
  localparam int unsigned CHUNK_BITS = index_bits(CHUNKS);
  localparam int unsigned LEVELS = $clog2(TAPS);
  // Weights are read, products, their sum; the bias, the shift, the cut.
  localparam int unsigned TO_SUM = 2 + LEVELS;
  localparam int unsigned STAGES = TO_SUM + 3;

  // Of some sections, and of the numbers as many bits as they have.
  logic unused_host;
  assign unused_host = ^{we_i, index_i, wdata_i};

  logic [VALUE_BITS-1:0] limit_q;
  logic [4:0] shift_q;
  always_ff @(posedge clk_i) begin
    if (we_i[Settings] && index_i == INDEX_BITS'(SETTING_INPUT)) limit_q <= wdata_i[VALUE_BITS-1:0];
    if (we_i[Settings] && index_i == INDEX_BITS'(SETTING_SHIFT)) shift_q <= wdata_i[4:0];
  end

  // ---- A group, a patch after the other ----

  logic [ROWS-1:0][ELEMENTS-1:0] elements_q;
  logic [WORD_BITS-1:0] word_q;
  logic [PLACE_BITS-1:0] place_q;
  logic [CHUNK_BITS-1:0] chunk_q;
  logic active_q, group_last_q, word_last, place_last, chunk_last;
  logic [STAGES:1] valid_q, last_q;

  assign word_last  = 32'(word_q) == WORDS - 1;
  assign place_last = 32'(place_q) == PLACES - 1;
  assign chunk_last = 32'(chunk_q) == CHUNKS - 1;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      active_q <= 1'b0;
      chunk_q  <= '0;
      word_q   <= '0;
      place_q  <= '0;
      valid_q  <= '0;
    end else begin
      if (active_q) begin
        chunk_q <= chunk_last ? '0 : chunk_q + 1'b1;
        word_q  <= word_last ? '0 : word_q + 1'b1;
        if (word_last) place_q <= place_last ? '0 : place_q + 1'b1;
      end
      if (valid_i) active_q <= 1'b1;
      else if (chunk_last) active_q <= 1'b0;
      valid_q <= {valid_q[STAGES-1:1], active_q};
    end
  end

  // The patch stands lowest: a column further, or over the edge to where the next row of patches begins.
  always_ff @(posedge clk_i) begin
    last_q <= {last_q[STAGES-1:1], group_last_q};
    if (valid_i) begin
      elements_q   <= elements_i;
      group_last_q <= last_i;
    end else if (word_last) begin
      for (int unsigned row = 0; row < ROWS; row++) begin
        elements_q[row] <= elements_q[row] >> (place_last ? SIDE * PLANES : PLANES);
      end
    end
  end

  assign valid_o = valid_q[STAGES];
  assign last_o  = last_q[STAGES];

  logic [ROWS-1:0][TAPS-1:0] patches, taps_q;
  for (genvar row = 0; row < ROWS; row++) begin : gen_patch
    for (genvar i = 0; i < SIDE; i++) begin : gen_line
      assign patches[row][i*SIDE*PLANES+:SIDE*PLANES] = elements_q[row][i*WIDTH*PLANES+:SIDE*PLANES];
    end
  end
  always_ff @(posedge clk_i) taps_q <= patches;

  // ---- The host's filter ----

  logic [TAP_BITS-1:0] write_tap;
  logic [WORD_BITS-1:0] write_word;
  logic [TAPS-1:0][WEIGHT_BITS-1:0] written_q;
  logic write_filter;
  assign write_tap    = index_i[TAP_BITS-1:0];
  assign write_word   = WORD_BITS'(32'(index_i) >> (TAP_BITS + COLUMN_BITS));
  assign write_filter = we_i[Scalings] && 32'(write_tap) == TAPS;

  // Memories have whole filters, a word each: of a memory for each weight, synthesis makes more LUTs, and takes
  // minutes.
  for (genvar k = 0; k < TAPS; k++) begin : gen_written
    always_ff @(posedge clk_i) begin
      if (we_i[Scalings] && 32'(write_tap) == k) written_q[k] <= wdata_i[WEIGHT_BITS-1:0];
    end
  end

  // ---- Each filter of a word ----

  for (genvar i = 0; i < PRODUCTS; i++) begin : gen_column
    logic at_column;
    logic [TAPS-1:0][WEIGHT_BITS-1:0] weights;
    logic signed [SUM_BITS-1:0] bias, bias_late;

    assign at_column = (32'(index_i) >> TAP_BITS) % (1 << COLUMN_BITS) == i;

    // A few words in LUTs, without the second register that a block RAM has anyway.
    pearl_memory #(
        .WIDTH(SUM_BITS + TAPS * WEIGHT_BITS),
        .DEPTH(WORDS)
    ) u_filters (
        .clk_i,
        .we_i   (write_filter && at_column),
        .waddr_i(write_word),
        .wdata_i({wdata_i, written_q}),
        .re_i   (active_q),
        .raddr_i(word_q),
        .rdata_o({bias, weights})
    );
    pearl_delay #(
        .WIDTH (SUM_BITS),
        .STAGES(TO_SUM - 1)
    ) u_bias (
        .clk_i,
        .d_i(bias),
        .d_o(bias_late)
    );

    for (genvar row = 0; row < ROWS; row++) begin : gen_row
      logic [TAPS-1:0][WEIGHT_BITS-1:0] terms_q;
      logic signed [WEIGHT_BITS+LEVELS-1:0] added;
      logic signed [SUM_BITS-1:0] sum_q, shifted_q;
      logic [VALUE_BITS-1:0] value_q;

      always_ff @(posedge clk_i) begin
        for (int unsigned k = 0; k < TAPS; k++) terms_q[k] <= taps_q[row][k] ? weights[k] : '0;
      end
      pearl_sum #(
          .TERMS(TAPS),
          .WIDTH(WEIGHT_BITS)
      ) u_sum (
          .clk_i,
          .terms_i(terms_q),
          .sum_o  (added)
      );
      always_ff @(posedge clk_i) begin
        sum_q     <= SUM_BITS'(added) + bias_late;
        shifted_q <= sum_q >>> shift_q;
        if (shifted_q < 0) value_q <= '0;
        else if (shifted_q > SUM_BITS'(limit_q)) value_q <= limit_q;
        else value_q <= shifted_q[VALUE_BITS-1:0];
      end
      assign values_o[row][i] = value_q;
    end
  end

endmodule
