// SPDX-License-Identifier: MIT
// Packs rows of bits into words, one continuous stream, and writes them to consecutive addresses.
//
// Any ratio of row to word works. The cost is a shifter over ROW_BITS bits with one level for each
// factor of two that DATA_WL has and ROW_BITS has not.
// Rows may only come when pearl_fill says that there is room.
module pearl_packer
  import pearl_pkg::*;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    // Words to write: a partial last one is filled up with zeros, surplus bits are dropped.
    parameter int unsigned WORDS = 3,
    localparam int unsigned ADDR_BITS = index_bits(WORDS)
) (
    input  logic                 clk_i,
    input  logic                 rst_ni,
    input  logic                 start_i,
    input  logic                 valid_i,
    input  logic                 last_i,
    input  logic [ ROW_BITS-1:0] row_i,
    output logic                 we_o,
    output logic [ADDR_BITS-1:0] waddr_o,
    output logic [  DATA_WL-1:0] wdata_o,
    // Every word has been written.
    output logic                 done_o
);

  localparam int unsigned UNIT = common_unit(ROW_BITS, DATA_WL);
  localparam int unsigned WORD_UNITS = DATA_WL / UNIT;
  // What is left of a word, and a row.
  localparam int unsigned ACC_BITS = ROW_BITS + DATA_WL - UNIT;

  logic word, last_q, done_q, room;
  logic [index_bits(WORD_UNITS)-1:0] offset;
  logic [ACC_BITS-1:0] acc_q, kept;
  logic [$clog2(WORDS+1)-1:0] count_q;

  pearl_fill #(
      .ROW_UNITS (ROW_BITS / UNIT),
      .WORD_UNITS(WORD_UNITS)
  ) u_fill (
      .clk_i,
      .rst_ni,
      .clear_i(start_i),
      .row_i(valid_i),
      .word_o(word),
      .offset_o(offset),
      .ready_o(room)
  );

  assign done_o = done_q;
  assign we_o = (word || last_q) && !done_q;
  assign waddr_o = count_q[ADDR_BITS-1:0];
  assign wdata_o = acc_q[DATA_WL-1:0];
  // Zeros in front, since a word may be all that there is.
  assign kept = word ? ACC_BITS'({DATA_WL'(0), acc_q} >> DATA_WL) : acc_q;

  always_ff @(posedge clk_i) begin
    if (start_i) acc_q <= '0;
    else if (valid_i) acc_q <= kept | (ACC_BITS'(row_i) << (32'(offset) * UNIT));
    else acc_q <= kept;
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      last_q  <= 1'b0;
      done_q  <= 1'b0;
      count_q <= '0;
    end else if (start_i) begin
      last_q  <= 1'b0;
      done_q  <= 1'b0;
      count_q <= '0;
    end else begin
      if (valid_i && last_i) last_q <= 1'b1;
      if (we_o) begin
        count_q <= count_q + 1'b1;
        done_q  <= 32'(count_q) == WORDS - 1;
      end
    end
  end

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (room || !valid_i)
      else $error("pearl_packer: a row came when there was no room for it");
    end
  end

endmodule
