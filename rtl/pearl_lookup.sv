// SPDX-License-Identifier: MIT
// A table of logits: the elements of each row of a group choose a row of it. A group a cycle.
//
// Every row of a group has a copy of the table.
module pearl_lookup
  import pearl_pkg::*;
#(
    parameter int unsigned ROWS = 4,
    parameter int unsigned ELEMENTS = 1,
    parameter int unsigned ELEMENT_BITS = 7,
    parameter int unsigned ACTIONS = 4,
    parameter int unsigned LOGIT_BITS = 8,
    // Rows of the table.
    parameter int unsigned TABLE_ROWS = 48,
    parameter int unsigned INDEX_BITS = 12
) (
    input logic clk_i,
    input logic rst_ni,

    input logic [NumSections-1:0] we_i,
    input logic [ INDEX_BITS-1:0] index_i,
    input logic [           31:0] wdata_i,

    input logic                                            valid_i,
    input logic [ROWS-1:0][ELEMENTS-1:0][ELEMENT_BITS-1:0] elements_i,

    output logic                                         valid_o,
    output logic [ROWS-1:0][ACTIONS-1:0][LOGIT_BITS-1:0] logits_o
);

  // What chooses a row is computed modulo a power of two, as the host has made sure that there is such a row.
  localparam int unsigned ROW_BITS = index_bits(TABLE_ROWS);
  localparam int unsigned COLUMN_BITS = index_bits(ACTIONS);
  localparam int unsigned LEVELS = $clog2(ELEMENTS + 1);
  localparam int unsigned STAGES = 1 + LEVELS + READ_LATENCY;

  // Of some sections, and of the numbers as many bits as they have.
  logic unused_host;
  assign unused_host = ^{we_i, index_i, wdata_i};

  logic [STAGES:1] valid_q;
  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[STAGES-1:1], valid_i};
  end
  assign valid_o = valid_q[STAGES];

  logic [ROW_BITS-1:0] first_q;
  logic [ELEMENTS-1:0][ROW_BITS-1:0] factors_q;
  always_ff @(posedge clk_i) begin
    if (we_i[Settings] && index_i == INDEX_BITS'(SETTING_INPUT)) first_q <= wdata_i[ROW_BITS-1:0];
    for (int unsigned i = 0; i < ELEMENTS; i++) begin
      if (we_i[Scalings] && index_i == INDEX_BITS'(i)) factors_q[i] <= wdata_i[ROW_BITS-1:0];
    end
  end

  for (genvar row = 0; row < ROWS; row++) begin : gen_row
    logic [ELEMENTS:0][ROW_BITS-1:0] terms_q;
    logic [ROW_BITS+LEVELS-1:0] chosen;

    always_ff @(posedge clk_i) begin
      for (int unsigned i = 0; i < ELEMENTS; i++) begin
        terms_q[i] <= ROW_BITS'($signed(elements_i[row][i])) * factors_q[i];
      end
      terms_q[ELEMENTS] <= first_q;
    end

    pearl_sum #(
        .TERMS(ELEMENTS + 1),
        .WIDTH(ROW_BITS)
    ) u_sum (
        .clk_i,
        .terms_i(terms_q),
        .sum_o  (chosen)
    );
    logic unused_chosen;
    assign unused_chosen = ^chosen;

    for (genvar i = 0; i < ACTIONS; i++) begin : gen_column
      pearl_ram #(
          .WIDTH(LOGIT_BITS),
          .DEPTH(TABLE_ROWS)
      ) u_table (
          .clk_i,
          .we_i   (we_i[Weights] && index_i[COLUMN_BITS-1:0] == COLUMN_BITS'(i)),
          .waddr_i(index_i[COLUMN_BITS+:ROW_BITS]),
          .wdata_i(wdata_i[LOGIT_BITS-1:0]),
          .re_i   (1'b1),
          .raddr_i(chosen[ROW_BITS-1:0]),
          .rdata_o(logits_o[row][i])
      );
    end
  end

endmodule
