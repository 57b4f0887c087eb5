// SPDX-License-Identifier: MIT
// From observations of a group's rows, as words, to inputs of a network on planes: pearl_show makes a picture of the
// words of each row, pearl_patches the inputs of that.
module pearl_planes
  import pearl_pkg::*;
  import pearl_engine_pkg::*;
#(
    parameter int unsigned ROWS = 4,
    parameter int unsigned INDEX_BITS = 12
) (
    input logic clk_i,
    input logic rst_ni,

    input logic [NumSections-1:0] we_i,
    input logic [ INDEX_BITS-1:0] index_i,
    input logic [           31:0] wdata_i,

    input logic                                valid_i,
    input logic                                last_i,
    input logic [ROWS-1:0][AGENT_OBS_BITS-1:0] obs_i,

    output logic                                          valid_o,
    output logic                                          last_o,
    output logic [ROWS-1:0][PRODUCTS-1:0][VALUE_BITS-1:0] values_o
);

  logic [ROWS-1:0] valids;
  logic [ROWS-1:0][HEIGHT*WIDTH*PLANES-1:0] pictures;
  logic last, unused_valids;
  // All come together.
  assign unused_valids = ^valids;

  for (genvar row = 0; row < ROWS; row++) begin : gen_row
    pearl_show u_show (
        .clk_i,
        .rst_ni,
        .valid_i,
        .obs_i    (obs_i[row]),
        .valid_o  (valids[row]),
        .picture_o(pictures[row])
    );
  end

  pearl_delay #(
      .WIDTH (1),
      .STAGES(SHOW_LATENCY)
  ) u_last (
      .clk_i,
      .d_i(last_i),
      .d_o(last)
  );

  pearl_patches #(
      .ROWS       (ROWS),
      .HEIGHT     (HEIGHT),
      .WIDTH      (WIDTH),
      .PLANES     (PLANES),
      .FILTERS    (FILTERS),
      .PRODUCTS   (PRODUCTS),
      .WEIGHT_BITS(WEIGHT_BITS),
      .VALUE_BITS (VALUE_BITS),
      .INDEX_BITS (INDEX_BITS)
  ) u_patches (
      .clk_i,
      .rst_ni,
      .we_i,
      .index_i,
      .wdata_i,
      .valid_i   (valids[0]),
      .last_i    (last),
      .elements_i(pictures),
      .valid_o,
      .last_o,
      .values_o
  );

endmodule
