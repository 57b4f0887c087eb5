// SPDX-License-Identifier: MIT
// Cuts a stream of words into rows of bits: the inverse of pearl_packer. It costs more, since words come
// to offsets anywhere in a row.
module pearl_unpacker
  import pearl_pkg::*;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL  = 32
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                valid_i,
    output logic                ready_o,
    input  logic [ DATA_WL-1:0] word_i,
    // No more words come: what is left is the last row, and what is missing of it is padding.
    input  logic                end_i,
    output logic                valid_o,
    input  logic                ready_i,
    output logic [ROW_BITS-1:0] row_o
);

  localparam int unsigned UNIT = common_unit(ROW_BITS, DATA_WL);
  localparam int unsigned ROW_UNITS = ROW_BITS / UNIT;
  localparam int unsigned WORD_UNITS = DATA_WL / UNIT;
  // What is short of a row, and a word.
  localparam int unsigned ACC_UNITS = ROW_UNITS + WORD_UNITS - 1;
  localparam int unsigned ACC_BITS = ACC_UNITS * UNIT;
  localparam int unsigned FILL_BITS = $clog2(ACC_UNITS + 1);

  logic take, accept;
  logic [FILL_BITS-1:0] fill_q, offset;
  logic [ACC_BITS-1:0] acc_q, kept;

  assign valid_o = 32'(fill_q) >= ROW_UNITS || end_i;
  assign row_o   = acc_q[ROW_BITS-1:0];
  assign take    = valid_o && ready_i;
  assign kept    = take ? acc_q >> ROW_BITS : acc_q;
  assign offset  = take ? fill_q - FILL_BITS'(ROW_UNITS) : fill_q;
  assign ready_o = 32'(offset) < ROW_UNITS;
  assign accept  = valid_i && ready_o;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      fill_q <= '0;
      acc_q  <= '0;
    end else begin
      fill_q <= accept ? offset + FILL_BITS'(WORD_UNITS) : offset;
      acc_q  <= accept ? kept | (ACC_BITS'(word_i) << (32'(offset) * UNIT)) : kept;
    end
  end

endmodule
